"""Stability, and the pole that violates it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from afdsvc.errors import BadInput, NotStabilising
from afdsvc.lti.scaling import state_scaling
from afdsvc.lti.statespace import Array, ComplexArray, StateSpace

MARGIN = 1e-12
SIGN = "check the sign of K (gains for negative feedback change sign here) or redesign it"


def eigenvalues(A: Array) -> ComplexArray:
    """Return the eigenvalues of A, computed in balanced coordinates."""
    if not A.shape[0]:
        return np.zeros(0, complex)
    t = state_scaling(A)
    return np.asarray(np.linalg.eigvals(A * (t[None, :] / t[:, None])), dtype=np.complex128)


def worst_pole(A: Array, dt: float) -> tuple[complex, float]:
    """Return the pole closest to (or farthest beyond) the border of stability and its relative margin.

    The margin is ``1 - |z|`` in discrete time and ``-Re s / max|s|`` in continuous time; positive means stable.
    """
    poles = eigenvalues(A)
    if not poles.size:
        return 0j, float("inf")
    scale = max(float(np.abs(poles).max()), np.finfo(float).tiny)
    margins = 1 - np.abs(poles) if dt > 0 else -poles.real / scale
    worst = int(np.argmin(margins))
    return complex(poles[worst]), float(margins[worst])


def is_stable(A: Array, dt: float) -> bool:
    """Whether every eigenvalue of A is stable by more than rounding (relative margin above 1e-12)."""
    return worst_pole(A, dt)[1] > MARGIN


def describe_pole(pole: complex, dt: float) -> str:
    """Return a pole in words: value and, in discrete time, its modulus."""
    value = f"{pole.real:.6g}" if abs(pole.imag) < 1e-12 * max(abs(pole), 1e-300) else f"{pole:.6g}"
    return f"{value} (modulus {abs(pole):.6g}, expected below 1)" if dt > 0 else f"{value} (expected a negative real part)"


def require_stable(A: Array, dt: float, what: str, cure: str) -> None:
    """Raise `BadInput` naming ``what``, its worst pole and the ``cure`` when A is not stable."""
    pole, margin = worst_pole(A, dt)
    if not margin > MARGIN:
        raise BadInput(f"{what} has the pole {describe_pole(pole, dt)}; {cure}")


def closed_loop_matrix(plant: StateSpace, controller: StateSpace) -> Array:
    """Return the state matrix of the loop ``y = G u, u = K y``; states of the plant first, then of the controller."""
    from afdsvc.lti.lft import star

    return star(plant, controller, plant.outputs, plant.inputs).A


def require_stabilising(plant: StateSpace, controller: StateSpace) -> None:
    """Raise `NotStabilising` with the offending pole, and why no controller could help if so, for an unstable loop."""
    pole, margin = worst_pole(closed_loop_matrix(plant, controller), plant.dt or controller.dt)
    if margin > MARGIN:
        return
    dt = plant.dt or controller.dt
    reason = _hidden_mode(plant, pole, "plant") or _hidden_mode(controller, pole, "controller") or SIGN
    raise NotStabilising(
        f"the closed loop (positive feedback, u = K y) has the pole {describe_pole(pole, dt)}: the controller does not "
        f"stabilise the plant; {reason}"
    )


def _hidden_mode(system: StateSpace, pole: complex, name: str) -> str:
    """Return a sentence if ``pole`` is a mode that inputs do not reach or outputs do not see, else ""."""
    n = system.order
    if not n or np.abs(eigenvalues(system.A) - pole).min() > 1e-6 * max(abs(pole), 1e-3):
        return ""
    t = state_scaling(system.A)
    A, B, C = system.A * (t[None, :] / t[:, None]), system.B / t[:, None], system.C * t[None, :]
    shifted = A - pole * np.eye(n)
    for word, pencil in (
        ("unobservable", np.vstack([shifted, _unit_rows(C)])),
        ("uncontrollable", np.hstack([shifted, _unit_rows(B.T).T])),
    ):
        rank = int(np.linalg.matrix_rank(pencil, tol=1e-8 * max(float(np.linalg.norm(A, 2)), 1e-300)))
        if rank < n:
            return f"this pole of the {name} is {word} (rank {rank} of {n}), so no controller can move it: change the model"
    return ""


def _unit_rows(M: Array) -> Array:
    """Return M with every nonzero row scaled to length one."""
    length = np.linalg.norm(M, axis=1, keepdims=True)
    return np.asarray(M / np.where(length > 0, length, 1.0), dtype=np.float64)


def trim(system: StateSpace) -> StateSpace:
    """Return the system without the states no input reaches or no output sees, judged by exact zeros only."""
    edges = system.A != 0
    reached = _closure(edges, (system.B != 0).any(axis=1))
    seen = _closure(edges.T, (system.C != 0).any(axis=0))
    keep = np.flatnonzero(reached & seen)
    if keep.size == system.order:
        return system
    return StateSpace(system.A[np.ix_(keep, keep)], system.B[keep], system.C[:, keep], system.D, system.dt)


def _closure(edges: NDArray[np.bool_], start: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the nodes reached from ``start`` when ``edges[i, j]`` leads from j to i."""
    reached = start.copy()
    while True:
        grown = reached | (edges & reached[None, :]).any(axis=1)
        if (grown == reached).all():
            return reached
        reached = grown
