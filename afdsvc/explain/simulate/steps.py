"""The plant over one sub-step of the simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from afdsvc.lti.sampling import continuous
from afdsvc.lti.statespace import Array, StateSpace

STEP_ANGLE = 0.5  # largest angle [rad] the fastest pole of a linear plant may turn in one sub-step
MOST_SUBSTEPS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """The plant over one sub-step ``h`` and half of it: ``x+ = phi x + gam u + gx f``, held u and f; ``f`` adds to dx/dt.

    Of an input that runs smoothly, ``u`` are the coefficients of its cubic in the share of the sub-step, constant first.
    """

    nsub: int
    phi: Array
    gam: Array
    gx: Array
    phih: Array
    gamh: Array


def substep_matrices(
    plant: StateSpace, dt: float, least: int = 1, angle: float = STEP_ANGLE, most: int = MOST_SUBSTEPS, degree: int = 0
) -> Steps:
    """Return the sub-step matrices of a plant sampled every ``dt`` seconds, for inputs that are polynomials of a ``degree``."""
    if plant.discrete:
        return _discrete_steps(plant)
    fastest = float(np.abs(plant.poles()).max(initial=0.0))
    return _continuous_steps(plant, dt, int(np.clip(np.ceil(fastest * dt / angle), least, max(most, least))), degree)


def _continuous_steps(plant: StateSpace, dt: float, nsub: int, degree: int = 0) -> Steps:
    h = dt / nsub
    phi, gam, gx = _driven(plant, h, h, degree)
    phih, gamh, _ = _driven(plant, h / 2, h, degree)
    return Steps(nsub, phi, gam, gx, phih, gamh)


def _driven(plant: StateSpace, t: float, h: float, degree: int) -> tuple[Array, Array, Array]:
    """Return what state, coefficients of the input in ``s/h`` and held force make of the state after ``t`` (Van Loan 1978).

    The derivatives of the input are states of a chain of integrators.
    """
    n, m = plant.B.shape
    chain = n + m * (degree + 1)
    big = np.zeros((chain + n, chain + n))
    big[:n, :n], big[:n, n : n + m], big[:n, chain:] = plant.A, plant.B, np.eye(n)
    big[n : chain - m, n + m : chain] = np.eye(m * degree)
    with np.errstate(over="ignore", invalid="ignore"):  # parameters of an intermediate fit may make the plant diverge
        e = sla.expm(big * t)
    unit = np.repeat([math.factorial(r) / h**r for r in range(degree + 1)], m)
    return contiguous(e[:n, :n]), contiguous(e[:n, n:chain] * unit), contiguous(e[:n, chain:])


def _discrete_steps(plant: StateSpace) -> Steps:
    """One step per sample; a force is held over it as the continuous counterpart would, if there is one."""
    n = plant.order
    twin = continuous(plant)
    if twin is None:
        eye = np.eye(n)
        return Steps(1, contiguous(plant.A), contiguous(plant.B), eye * plant.dt, eye, np.zeros_like(plant.B))
    half = _continuous_steps(twin, plant.dt, 1)
    return Steps(1, contiguous(plant.A), contiguous(plant.B), half.gx, half.phih, half.gamh)


def ways(plant: StateSpace, moving: Array, along: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return what forces along signals do to the rates of the states ``(n, E)``, and the gains ``(E,)`` of the signals at the states they are written to.

    Rows of ``along (E, 3)`` are a signal's number, whether it is an input, else a state that acts on the states ``moving``, and the state written to.
    """
    smooth = (continuous(plant) if plant.discrete else None) or plant
    columns = np.array([smooth.B[:, j] if driven else np.where(moving, smooth.A[:, j], 0.0) for j, driven, _ in along]).reshape(-1, plant.order).T
    gains = np.array([columns[i, e] or 1.0 for e, (_, _, i) in enumerate(along)])
    return columns / gains, gains


def contiguous(matrix: Array) -> Array:
    """Return the matrix as the compiled simulation takes it: rows one after the other."""
    return np.ascontiguousarray(matrix)
