"""The sum of squares everything is judged by: whitened residuals over runs, with the nuisance parameters projected out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla

from afdsvc.dataset.experiment import Run
from afdsvc.explain.simulator import Effect, Simulator
from afdsvc.lti.statespace import Array
from afdsvc.stats.ar_noise import Whitener

THETA_STEP = 0.02  # of a prior standard deviation
FAR = 1e30


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """Where the search stands: nuisance ``theta`` in prior sds, initial state per run, effects with values."""

    theta: Array
    x0: tuple[Array, ...]
    effects: tuple[Effect, ...] = ()

    def with_effect(self, effect: Effect) -> Point:
        """Return the point with one more effect."""
        return replace(self, effects=(*self.effects, effect))


@dataclass(frozen=True, slots=True, eq=False)
class Objective:
    """Residuals of some runs against a simulator, whitened to unit variance."""

    simulator: Simulator
    runs: tuple[Run, ...]
    whitener: Whitener

    @property
    def samples(self) -> int:
        """How many numbers the residual holds."""
        return sum(r.Y.size for r in self.runs)

    def residual(self, i: int, theta: Array, x0: Array, effects: Sequence[Effect], first: int | None = None) -> Array:
        """Return the residual ``y - yhat`` of run ``i``, shape ``(n, p)``, zero in gaps; `FAR` where the simulation left.

        ``first`` asks for so many samples only.
        """
        run = self.runs[i] if first is None else self.runs[i].span(0, first)
        e = run.Y - self.simulator.run(run, theta, x0, effects).y
        lost = ~np.isfinite(e) & np.isfinite(run.Y)
        if lost.any():
            return np.full_like(e, np.sqrt(FAR / e.size))
        return np.nan_to_num(e)

    def whitened(self, point: Point) -> list[Array]:
        """Return the whitened residual of each run."""
        pairs = zip(range(len(self.runs)), point.x0, strict=True)
        return [self.whitener(self.residual(i, point.theta, x0, point.effects)) for i, x0 in pairs]

    def vector(self, point: Point) -> Array:
        """Return the whitened residuals of all runs as one vector."""
        return np.concatenate([w.ravel() for w in self.whitened(point)])


@dataclass(frozen=True, slots=True, eq=False)
class Tangent:
    """The objective linearised in its nuisance at a point: theta (with its prior), initial states, and effects accepted before.

    ``q`` spans what the nuisance can do (orthonormal columns over data and prior rows), ``r`` is its triangular factor,
    ``rest`` the projected residual at the point, ``columns`` the number of nuisance parameters.
    """

    objective: Objective
    point: Point
    q: Array
    r: Array
    full: Array
    rest: Array
    scales: Array

    @property
    def cost(self) -> float:
        """The sum of squares the nuisance cannot lower (in the tangent)."""
        return float(self.rest @ self.rest)

    def project(self, data: Array) -> Array:
        """Return what of a change of the whitened residual the nuisance cannot imitate (data and prior rows)."""
        v = np.zeros(self.q.shape[0])
        v[: data.size] = data
        return np.asarray(v - self.q @ (self.q[: data.size].T @ data))

    def shift(self, residual: Array) -> Array:
        """Return the nuisance step that answers a full residual (data rows with prior rows) best, in natural units."""
        return np.asarray(-sla.solve_triangular(self.r, self.q.T @ residual) * self.scales)

    def with_data(self, data: Array) -> Array:
        """Return the full residual vector that has these data rows and the prior rows of the point."""
        return np.concatenate([data, self.full[data.size :]])


@dataclass(frozen=True, slots=True, eq=False)
class Slope:
    """What a `Tangent` is for refitting alone: the Jacobian ``J`` (data rows), its triangular factor ``r`` with the prior."""

    point: Point
    J: Array
    weight: Array
    r: Array
    full: Array
    scales: Array

    def shift(self, residual: Array, damping: float = 0.0) -> Array:
        """Return the nuisance step that answers a full residual (data rows with prior rows) best, in natural units.

        ``damping`` shortens it towards steepest descent (Levenberg-Marquardt).
        """
        rows = len(self.J)
        g = self.J.T @ residual[:rows] + self.weight * residual[rows:]
        if not damping:
            return np.asarray(-sla.cho_solve((self.r, False), g) * self.scales)
        H = self.r.T @ self.r
        return np.asarray(-np.linalg.solve(H + damping * np.diag(np.diag(H)), g) * self.scales)


@dataclass(frozen=True, slots=True, eq=False)
class Borrowed:
    """Columns of theta and the initial states from a point nearby, with other effects: ``J (data, count)``, their scales."""

    J: Array
    scales: Array


def borrowed(t: Tangent) -> Borrowed:
    """Return what a tangent lends to refits of its objective with other effects."""
    count = len(t.point.theta) + sum(len(x) for x in t.point.x0)
    rows = t.objective.samples
    return Borrowed(t.q[:rows] @ t.r[:, :count], t.scales[:count])


def slope(objective: Objective, point: Point, states_only: bool = False, known: Borrowed | None = None) -> Slope:
    """Return the objective's slope in its nuisance at a point, by normal equations: columns are scaled and have a prior.

    ``known`` columns are taken as they are; only those of the point's effects are worked out.
    """
    data = objective.vector(point)
    J, (weights, own), scales = _columns(objective, point, data, states_only, known)
    weight = np.diag(weights).copy()
    return Slope(point, J, weight, _factor(J.T @ J + np.diag(weight**2)), np.concatenate([data, own]), scales)


def _factor(H: Array) -> Array:
    """Return the upper factor of a normal matrix; one that rounding made singular, where a simulation left, gets a ridge."""
    try:
        return np.asarray(np.linalg.cholesky(H).T, dtype=np.float64)
    except np.linalg.LinAlgError:
        ridge = 1e-9 * np.maximum(np.diag(H), 1e-12 * float(np.trace(H)))
        return np.asarray(np.linalg.cholesky(H + np.diag(ridge)).T, dtype=np.float64)


def tangent(objective: Objective, point: Point, states_only: bool = False) -> Tangent:
    """Linearise at a point; effects of the point count as nuisance. ``states_only`` frees the initial states alone."""
    data = objective.vector(point)
    columns, prior_rows, scales = _columns(objective, point, data, states_only)
    full = np.concatenate([data, prior_rows[1]])
    J = np.vstack([columns, prior_rows[0]])
    q, r = np.linalg.qr(J)
    rest = full - q @ (q.T @ full)
    return Tangent(objective, point, q, r, full, rest, scales)


def _columns(
    objective: Objective, point: Point, data: Array, states_only: bool, known: Borrowed | None = None
) -> tuple[Array, tuple[Array, Array], Array]:
    """Return the scaled Jacobian of the data, the prior rows (Jacobian, residual), and the scale of each parameter."""
    k = 0 if states_only else len(point.theta)
    states = sum(len(x) for x in point.x0)
    etas = 0 if states_only else sum(len(e.values) for e in point.effects)
    total = k + states + etas
    J, scales = np.zeros((data.size, total)), np.ones(total)
    if known is None:
        _theta_columns(objective, point, data, J, k)
        _state_columns(objective, point, J, scales, k)
    else:
        J[:, : k + states], scales[: k + states] = known.J, known.scales
    if etas:
        _effect_columns(objective, point, data, J, scales, k + states)
    weight = np.full(total, 1e-3)
    weight[:k] = 1.0
    return J, (np.diag(weight), prior_rows(point, k, total)), scales


def prior_rows(point: Point, k: int, total: int) -> Array:
    """Return the residual of the prior: theta for its ``k`` freed entries, nothing for the other nuisance."""
    own = np.zeros(total)
    own[:k] = point.theta[:k]
    return own


def _theta_columns(objective: Objective, point: Point, data: Array, J: Array, k: int) -> None:
    for j in range(k):
        step = np.zeros(len(point.theta))
        step[j] = THETA_STEP
        J[:, j] = (objective.vector(replace(point, theta=point.theta + step)) - data) / THETA_STEP


def _state_columns(objective: Objective, point: Point, J: Array, scales: Array, first: int) -> None:
    """Fill the columns of the initial states, one unit being what moves the residual by its own size."""
    row, column = 0, first
    for i, (run, x0) in enumerate(zip(objective.runs, point.x0, strict=True)):
        memory = min(len(run), _memory(objective, point.theta))
        base = objective.whitener(objective.residual(i, point.theta, x0, point.effects, memory)).ravel()
        for j in range(len(x0)):
            moved = x0.copy()
            step = 1e-3 * max(abs(x0[j]), _state_step(run, objective, j))
            moved[j] += step
            change = objective.whitener(objective.residual(i, point.theta, moved, point.effects, memory)).ravel() - base
            norm = float(np.linalg.norm(change))
            scales[column] = step / norm if norm > 0 else 0.0
            J[row : row + base.size, column] = change / norm if norm > 0 else 0.0
            column += 1
        row += run.Y.size


def _memory(objective: Objective, theta: Array) -> int:
    """Return after how many samples the initial state is forgotten by the corrected simulation, to nine digits."""
    nominal = objective.simulator.nominal
    s = nominal.steps(theta)
    kept = np.linalg.matrix_power(s.phi, s.nsub) - objective.simulator.gain @ nominal.at(theta).C
    slowest = float(np.abs(np.linalg.eigvals(kept)).max(initial=0.0))
    if slowest >= 1 - 1e-9:
        return int(1e9)
    return 100 + int(1.3 * np.log(1e-9) / np.log(max(slowest, 1e-3)))


def _state_step(run: Run, objective: Objective, j: int) -> float:
    c = np.abs(objective.simulator.nominal.plant.C[:, j]).max(initial=0.0)
    y = float(np.nanstd(run.Y)) or 1.0
    return y / c if c > 0 else y


def _effect_columns(objective: Objective, point: Point, data: Array, J: Array, scales: Array, first: int) -> None:
    column = first
    for number, effect in enumerate(point.effects):
        for j, coefficient in enumerate(effect.hypothesis.parameters):
            step = small_step(effect.values[j], coefficient.scale, coefficient.low, coefficient.high)
            moved = effect.values.copy()
            moved[j] += step
            effects = list(point.effects)
            effects[number] = Effect(effect.hypothesis, moved)
            change = objective.vector(replace(point, effects=tuple(effects))) - data
            norm = float(np.linalg.norm(change))
            J[:, column] = change / norm if norm > 0 else 0.0
            scales[column] = step / norm if norm > 0 else 0.0
            column += 1


def small_step(value: float, scale: float, low: float, high: float) -> float:
    """Return a finite-difference step that stays inside the range."""
    step = min(1e-3 * max(abs(value), abs(scale), 1e-300), 0.5 * (high - low))
    return -step if value + step > high else step
