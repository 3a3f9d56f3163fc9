"""The nominal model as the search sees it: which numbers are free, how far they may move, and the matrices they make.

The free numbers ("nuisance parameters") are the entries of A, B, C, D that are neither 0 nor +-1, or those with a stated
standard deviation. They are counted in units of that deviation, so their prior is standard normal.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.linalg as sla

from afdsvc.api.model import Model
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array, StateSpace

DEFAULT_RELATIVE_SD = 0.05
STEP_ANGLE = 0.5  # largest angle [rad] the fastest pole may turn in one sub-step


@dataclass(frozen=True, slots=True)
class Entry:
    """One free number of the linear model: matrix, row, column, and the standard deviation its owner states."""

    matrix: str
    row: int
    column: int
    sd: float


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """The plant over one sub-step ``h`` and half of it: ``x+ = phi x + gam u + gx f``, held u and f; ``f`` adds to dx/dt."""

    nsub: int
    phi: Array
    gam: Array
    gx: Array
    phih: Array
    gamh: Array


@dataclass(frozen=True, slots=True, eq=False)
class Nominal:
    """A linear nominal model at the sample time of the recordings.

    ``plant`` is continuous (dt 0), or discrete when no continuous one has this sampling. ``entries`` are the free numbers.
    """

    model: Model
    plant: StateSpace
    entries: tuple[Entry, ...]
    dt: float

    def at(self, theta: Array) -> StateSpace:
        """Return the plant with its free numbers moved by ``theta`` standard deviations, shape ``(len(entries),)``."""
        parts = {"A": self.plant.A.copy(), "B": self.plant.B.copy(), "C": self.plant.C.copy(), "D": self.plant.D.copy()}
        for value, entry in zip(theta, self.entries, strict=True):
            parts[entry.matrix][entry.row, entry.column] += value * entry.sd
        return StateSpace(parts["A"], parts["B"], parts["C"], parts["D"], self.plant.dt)

    def steps(self, theta: Array, least: int = 1) -> Steps:
        """Return the matrices the simulation needs, in at least that many sub-steps."""
        return _cached_steps(self, theta.tobytes(), least)


@lru_cache(maxsize=64)
def _cached_steps(nominal: Nominal, theta: bytes, least: int) -> Steps:
    return steps(nominal.at(np.frombuffer(theta)), nominal.dt, least)


def nominal(model: Model, dt: float) -> Nominal:
    """Return the nominal model for recordings sampled every ``dt`` seconds.

    Raises `BadInput` when a discrete model has another sample time and no continuous counterpart.
    """
    if model.plant is None:
        raise BadInput(f"model '{model.name}' has no matrices; a linear model is wanted here")
    plant, sds = model.plant, dict(model.entry_sd)
    if plant.discrete and abs(plant.dt / dt - 1) > 1e-6:
        plant, sds = _continuous(model.name, plant, dt), {}
    return Nominal(model, plant, _entries(plant, sds), dt)


def _continuous(name: str, plant: StateSpace, dt: float) -> StateSpace:
    found = continuous(plant)
    if found is None:
        raise BadInput(
            f"model '{name}' is sampled every {plant.dt:g} s and the recording every {dt:g} s; a pole on the "
            "negative real axis or at zero forbids another sample time, so one of the two must be resampled"
        )
    return found


def continuous(plant: StateSpace) -> StateSpace | None:
    """Return the continuous plant whose zero-order hold this discrete one is; None when there is none that is real."""
    n, m = plant.B.shape
    if n == 0:
        return StateSpace.gain(plant.D)
    poles = plant.poles()
    if (np.abs(poles) < 1e-9).any() or ((poles.real < 0) & (np.abs(poles.imag) < 1e-9)).any():
        return None
    big = np.block([[plant.A, plant.B], [np.zeros((m, n)), np.eye(m)]])
    with warnings.catch_warnings():  # its estimate of the error is a few roundings; what counts is checked below
        warnings.simplefilter("ignore")
        log = np.asarray(sla.logm(big))
    if not np.isfinite(log).all() or np.abs(np.imag(log)).max() > 1e-6 * np.abs(log).max():
        return None
    if np.abs(sla.expm(np.real(log)) - big).max() > 1e-6 * np.abs(big).max():
        return None
    rate = np.real(log) / plant.dt
    return StateSpace(rate[:n, :n], rate[:n, n:], plant.C, plant.D)


def _entries(plant: StateSpace, stated: Mapping[str, Array]) -> tuple[Entry, ...]:
    found: list[Entry] = []
    for name in ("A", "B", "C", "D"):
        matrix: Array = getattr(plant, name)
        sd = np.asarray(stated[name], float) if name in stated else _default_sd(matrix)
        if sd.shape != matrix.shape:
            raise BadInput(f"uncertainty of {name} has shape {sd.shape}; {matrix.shape} is wanted")
        found += [Entry(name, int(i), int(j), float(sd[i, j])) for i, j in np.argwhere(sd > 0)]
    return tuple(found)


def _default_sd(matrix: Array) -> Array:
    fixed = (matrix == 0) | (np.abs(matrix) == 1)
    return np.where(fixed, 0.0, DEFAULT_RELATIVE_SD * np.abs(matrix))


def steps(plant: StateSpace, dt: float, least: int = 1) -> Steps:
    """Return the sub-step matrices of a plant sampled every ``dt`` seconds."""
    if plant.discrete:
        return _discrete_steps(plant)
    fastest = float(np.abs(plant.poles()).max(initial=0.0))
    nsub = int(np.clip(np.ceil(fastest * dt / STEP_ANGLE), least, 20))
    return _continuous_steps(plant, dt, nsub)


def _continuous_steps(plant: StateSpace, dt: float, nsub: int) -> Steps:
    h = dt / nsub
    phi, gam, gx = _held(plant, h)
    phih, gamh, _ = _held(plant, h / 2)
    return Steps(nsub, phi, gam, gx, phih, gamh)


def _held(plant: StateSpace, h: float) -> tuple[Array, Array, Array]:
    n, m = plant.B.shape
    big = np.zeros((2 * n + m, 2 * n + m))
    big[:n] = np.hstack([plant.A, plant.B, np.eye(n)])
    with np.errstate(over="ignore", invalid="ignore"):  # a fit may look where everything leaves: its simulation is given up then
        e = sla.expm(big * h)
    return _c(e[:n, :n]), _c(e[:n, n : n + m]), _c(e[:n, n + m :])


def _discrete_steps(plant: StateSpace) -> Steps:
    """One step per sample; a force is held over it as the continuous counterpart would, if there is one."""
    n = plant.order
    twin = continuous(plant)
    if twin is None:
        eye = np.eye(n)
        return Steps(1, _c(plant.A), _c(plant.B), eye * plant.dt, eye, np.zeros_like(plant.B))
    half = _continuous_steps(twin, plant.dt, 1)
    return Steps(1, _c(plant.A), _c(plant.B), half.gx, half.phih, half.gamh)


def _c(matrix: Array) -> Array:
    return np.ascontiguousarray(matrix)
