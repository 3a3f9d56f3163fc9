"""Levenberg-Marquardt over everything that is free: numbers of the model, initial states, offsets, parameters of effects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from afdsvc.api.physics import Coefficient, Hypothesis
from afdsvc.explain.noise.weighting import correlation_time
from afdsvc.explain.search.problem import NUISANCE, Point, Problem
from afdsvc.lti.statespace import Array

STEP = 1e-4  # finite difference, in units of the prior or of the parameter
TINY = 1e-12
GROWTH, ATTEMPTS, SHORTER = 4.0, 6, 0.5  # of the damping where a step succeeds; how many are tried, each this share of the last or less
ENOUGH, CONVERGED = 0.1, 1e-3  # fall of the cost (log-likelihood) at which a fit ends, and the fit of what is accepted


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A fit at one horizon.

    ``residuals`` are weighted, one ``(n, p)`` per run; ``J (rows, k)`` their Jacobian in the coordinates of `Coordinates`, ``H``
    and ``tau`` the information matrix (prior included) and the correlation time it counts samples by; ``cost`` is minus the
    log posterior, ``penalty`` its part from the priors, ``shared`` the
    number of coordinates that all recordings share, ``sd (p,)`` the rms of the weighted residual. ``narrowed`` is what it costs to fit
    what unsettled memories begin with: twice the logarithm of prior over posterior standard deviation, summed (MacKay 1992, Occam factor).
    """

    point: Point
    residuals: tuple[Array, ...]
    J: Array
    H: Array
    tau: float
    cost: float
    sd: Array
    penalty: float
    shared: int
    narrowed: float = 0.0

    @property
    def samples(self) -> int:
        """How many samples of one output there are."""
        return sum(len(e) for e in self.residuals)

    @property
    def deviance(self) -> float:
        """Minus twice the log-likelihood of independent samples, up to a constant."""
        return float(2 * self.samples * np.log(self.sd).sum())

    @property
    def own_tau(self) -> float:
        """The correlation time of this fit's own residual."""
        return correlation_time(self.residuals)


class Coordinates:
    """The free numbers as one vector of order-one coordinates: theta, offsets, parameters of effects, then run by run the initial
    state and what unsettled memories of effects begin with.

    Positive shape parameters are logarithmic. ``locked`` effects keep their values.
    """

    def __init__(self, problem: Problem, point: Point) -> None:
        self.problem, self.base = problem, point
        self.k = len(point.theta)
        self.p = len(point.offset) if problem.offset_free else 0
        self.slots = [(i, j, c) for i, e in enumerate(point.effects) for j, c in enumerate(e.hypothesis.parameters) if c.free]
        self.units = [min(max(abs(point.effects[i].values[j]), c.scale, 1e-300), c.high - c.low) for i, j, c in self.slots]
        known = all(r.steady for r in problem.runs)
        self.unsettled = [(i, h.unsettled) for i, h in enumerate(e.hypothesis for e in point.effects) if h.unsettled and (h.lasting or not known)]
        sizes = [np.full(count, problem.size(point.effects[i].hypothesis.reads[0])) for i, count in self.unsettled]
        self.local = np.concatenate([problem.state_scale, *sizes])
        self.n = len(self.local) if point.x0 else 0
        self.shared = self.k + self.p + len(self.slots)
        self.size = self.shared + self.n * len(point.x0)
        s = problem.settings
        self.prior_mean = np.zeros(self.size)
        self.prior_weight = np.zeros(self.size)
        self.prior_weight[: self.k] = 1 / s.theta_sd
        self.prior_weight[self.k : self.k + self.p] = 1 / s.offset_sd
        for k, (i, _, _) in enumerate(self.slots):
            if point.effects[i].hypothesis.family == NUISANCE:
                self.units[k], self.prior_weight[self.k + self.p + k] = self.slots[k][2].scale, 1.0
        self.prior_weight[self.shared :] = 1 / s.state_sd
        self.prior_mean[self.shared :] = np.concatenate([np.pad(x / problem.state_scale, (0, self.n - len(x))) for x in problem.x0]) if problem.x0 else []

    def narrowed(self, H: Array) -> float:
        """Return how much the recordings narrow what unsettled memories begin with, initial states unknown: see `Fit`."""
        order, total = len(self.problem.state_scale), 0.0
        for first in range(self.shared, self.size if self.n > order else 0, self.n):
            local, states = slice(first, first + self.n), slice(first, first + order)
            total += float(np.linalg.slogdet(H[local, local])[1] - np.linalg.slogdet(H[states, states])[1])
            total -= float(np.log(self.prior_weight[first + order : first + self.n] ** 2).sum())
        return total

    def pack(self, point: Point) -> Array:
        """Return the coordinates of a point."""
        values = [_inward(c, point.effects[i].values[j], u) for (i, j, c), u in zip(self.slots, self.units, strict=True)]
        local = [np.concatenate([x, *self._begun(point, r)]) / self.local for r, x in enumerate(point.x0)]
        return np.concatenate([point.theta, (point.offset / self.problem.scale)[: self.p], values, *local])

    def _begun(self, point: Point, r: int) -> list[Array]:
        return [point.effects[i].begun[r] if point.effects[i].begun else np.zeros(count) for i, count in self.unsettled]

    def unpack(self, q: Array) -> Point:
        """Return the point with these coordinates, parameters held to their ranges."""
        effects = [e.values.copy() for e in self.base.effects]
        for (i, j, c), u, z in zip(self.slots, self.units, q[self.k + self.p : self.shared], strict=True):
            effects[i][j] = min(max(_outward(c, z, u), c.low), c.high)
        local = [q[self.shared + self.n * r : self.shared + self.n * (r + 1)] * self.local for r in range(len(self.base.x0))]
        order = len(self.problem.state_scale)
        offset = self.base.offset if not self.p else q[self.k : self.k + self.p] * self.problem.scale
        begun: list[tuple[Array, ...]] = [()] * len(effects)
        first = order
        for i, count in self.unsettled:
            begun[i], first = tuple(x[first : first + count] for x in local), first + count
        made = tuple(replace(e, values=v, begun=b) for e, v, b in zip(self.base.effects, effects, begun, strict=True))
        return Point(q[: self.k], tuple(x[:order] for x in local), offset, made)

    def penalty(self, q: Array) -> float:
        """Half the sum of squares of the prior."""
        return 0.5 * float(np.sum((self.prior_weight * (q - self.prior_mean)) ** 2))


def priced(problem: Problem, fit: Fit, h: Hypothesis) -> int:
    """Return how many free numbers of an effect cost evidence: all but nuisances that the recordings say nothing of (MacKay 1992, Occam factor)."""
    c = Coordinates(problem, fit.point)
    mine = [(c.k + c.p + n, k.nuisance) for n, (i, _, k) in enumerate(c.slots) if fit.point.effects[i].hypothesis.key == h.key]
    return sum(not nuisance or bool(fit.H[column, column] > 1.0) for column, nuisance in mine)


def logarithmic(c: Coefficient) -> bool:
    """Whether a parameter is searched on a logarithmic scale: a positive one whose range is not a narrow band."""
    return c.low >= 0 and not c.linear and c.high > 2 * c.low


def _inward(c: Coefficient, value: float, unit: float) -> float:
    return float(np.log(max(value, c.low, 1e-9 * unit) / unit)) if logarithmic(c) else float(value / unit)


def _outward(c: Coefficient, z: float, unit: float) -> float:
    return float(unit * np.exp(min(z, 50.0))) if logarithmic(c) else float(z * unit)


def weighted(problem: Problem, point: Point, horizon: float) -> tuple[Array, ...]:
    """Return the weighted residuals of every run."""
    return tuple(problem.weighting(e) for e in problem.residuals(point, horizon))


def rms(residuals: Sequence[Array]) -> Array:
    """Return the rms per output over all runs, with a floor that keeps a perfect fit finite."""
    power = sum(np.array([column @ column for column in e.T]) for e in residuals)
    return np.asarray(np.sqrt(power / sum(map(len, residuals)) + TINY))


def jacobian(
    problem: Problem, c: Coordinates, q: Array, horizon: float, residuals: Sequence[Array], known: Array | None = None, kept: tuple[int, int] = (0, 0)
) -> Array:
    """Return ``d(weighted residual) / dq``, ``(rows, size)``: shared columns first, then those of what every run begins with.

    Of a ``known`` one the first ``kept`` columns, shared and of every run, are left as they are.
    """
    J = np.zeros((sum(e.size for e in residuals), c.size)) if known is None else known.copy()
    shared = [[k] for k in range(kept[0], c.shared)]
    begun = [[c.shared + c.n * r + s for r in range(len(residuals))] for s in range(kept[1], c.n)]  # those of all recordings are found together
    rows = np.concatenate([[0], np.cumsum([e.size for e in residuals])])
    columns = problem.mapper(partial(_column, problem, c, q, horizon=horizon, residuals=residuals), [*shared, *begun])
    for at, column in zip([*shared, *begun], columns, strict=True):
        if at[0] < c.shared:
            J[:, at[0]] = column
        else:
            for r, k in enumerate(at):
                J[rows[r] : rows[r + 1], k] = column[rows[r] : rows[r + 1]]
    J[~np.isfinite(J)] = 0.0
    return J


def borrowed(problem: Problem, base: Fit, point: Point, horizon: float) -> Array:
    """Return the Jacobian at ``base`` with one effect added in ``point``: only the columns of the effect are worked out."""
    c, old = Coordinates(problem, point), Coordinates(problem, base.point)
    J = np.zeros((len(base.J), c.size))
    J[:, : old.shared] = base.J[:, : old.shared]
    for r in range(len(point.x0)):
        J[:, c.shared + c.n * r : c.shared + c.n * r + old.n] = base.J[:, old.shared + old.n * r : old.shared + old.n * (r + 1)]
    return jacobian(problem, c, c.pack(point), horizon, weighted(problem, point, horizon), J, column_counts(problem, base.point))


def column_counts(problem: Problem, point: Point) -> tuple[int, int]:
    """Return how many columns of a Jacobian all recordings share, and how many each one has."""
    c = Coordinates(problem, point)
    return c.shared, c.n


def _column(problem: Problem, c: Coordinates, q: Array, at: Sequence[int], horizon: float, residuals: Sequence[Array]) -> Array:
    """Return the change of the residuals with coordinates moved together; a step that a range forbids goes the other way."""
    here = c.pack(c.unpack(q))
    for h in (STEP, -STEP):
        moved = q.copy()
        moved[list(at)] += h
        point = c.unpack(moved)
        done = c.pack(point)[at[0]] - here[at[0]]
        if abs(done) > 0.5 * abs(h):
            change = [b - a for a, b in zip(residuals, weighted(problem, point, horizon), strict=True)]
            return np.asarray(np.concatenate([x.ravel() for x in change]) / done)
    return np.zeros(sum(e.size for e in residuals))


def fit(
    problem: Problem, point: Point, horizon: float, tau: float, iterations: int = 100, known: Array | None = None,
    renewals: int | None = None, enough: float = ENOUGH, kept: tuple[int, int] = (0, 0),
) -> Fit:
    """Return the local optimum of the posterior from ``point`` at one horizon.

    The log-likelihood is ``-N/(2 tau) sum_j log(SSE_j/N)``: noise variances are estimated under the hypothesis, and correlated
    samples count as ``N/tau``, which keeps the priors alive. Steps are those of Levenberg and Marquardt; between them the Jacobian
    follows by Broyden's rule, and is worked out anew where a step fails. Damping is the same for all coordinates, which have the size of
    their priors, and grows ever faster where steps fail (Nielsen 1999). ``known`` is a Jacobian to begin with. With ``renewals`` it
    is worked out anew as often at most, but for its ``kept`` columns, and the last one is left as it is. A fit ends where the cost falls by less than ``enough``.
    """
    c = Coordinates(problem, point)
    q = c.pack(c.unpack(c.pack(point)))
    residuals = weighted(problem, c.unpack(q), horizon)
    n = sum(len(e) for e in residuals)

    def cost_of(q: Array, residuals: Sequence[Array]) -> float:
        value = n / tau * float(np.log(rms(residuals)).sum()) + c.penalty(q)
        return value if np.isfinite(value) else np.inf

    cost, damping, fresh, renewed = cost_of(q, residuals), 1e-3, known is None, int(known is None)
    J = Followed(jacobian(problem, c, q, horizon, residuals) if known is None else known, len(problem.scale))
    for _ in range(iterations):
        _, curvature, slope = _normal(J, residuals, tau, c, q)
        step = _improving(problem, c, q, curvature, slope, cost, damping, horizon, cost_of)
        fall, exact = 0.0 if step is None else cost - step[2], fresh
        if step is not None:
            J.follow(step[0] - q, np.vstack(step[1]) - np.vstack(residuals))
            fresh = False
            q, residuals, cost, damping = step
        if fall < enough:
            if exact or (renewals is not None and renewed >= renewals):
                break
            J = Followed(jacobian(problem, c, q, horizon, residuals, J.array(), kept), J.outputs)
            fresh, renewed, damping = True, renewed + 1, min(damping, 1e-3)
    if renewals is None and not fresh:
        J = Followed(jacobian(problem, c, q, horizon, residuals), J.outputs)
    H, *_ = _normal(J, residuals, tau, c, q)
    return Fit(c.unpack(q), tuple(residuals), J.array(), H, tau, cost, rms(residuals), c.penalty(q), c.shared, c.narrowed(H))


class Followed:
    """A Jacobian that follows the steps seen by Broyden's rule (1965): ``J + sum r s^T``, with its Gram matrices ``(p, k, k)``, one per output.

    What follows is kept as vectors: a step costs products of vectors with ``J``, not a pass that writes it.
    """

    def __init__(self, J: Array, outputs: int) -> None:
        self.J, self.outputs = J, outputs
        self.changes: list[tuple[Array, Array]] = []
        self.gram = np.array([part.T @ part for part in map(self._of, range(outputs))])

    def _of(self, j: int) -> Array:
        """Return the rows of output ``j``."""
        return self.J[j :: self.outputs]

    def along(self, residuals: Array) -> Array:
        """Return ``J^T e`` of every output, ``(p, k)``; ``residuals (n, p)``."""
        along = np.array([self._of(j).T @ residuals[:, j] for j in range(self.outputs)])
        return np.asarray(along + sum(np.outer((r * residuals).sum(0), s) for r, s in self.changes))

    def follow(self, step: Array, seen: Array) -> None:
        """Change the Jacobian least so that it gives the change of the residuals ``seen (n, p)`` over a step."""
        expected = (self.J @ step).reshape(seen.shape) + sum(r * float(s @ step) for r, s in self.changes)
        r, s = seen - expected, step / max(float(step @ step), TINY)
        cross = self.along(r)[:, :, None] * s
        self.gram = self.gram + cross + cross.transpose(0, 2, 1) + (r**2).sum(0)[:, None, None] * np.outer(s, s)
        self.changes.append((r, s))

    def array(self) -> Array:
        """Return the Jacobian, ``(rows, k)``."""
        if not self.changes:
            return self.J
        r, s = zip(*self.changes, strict=True)
        return np.asarray(self.J + np.column_stack([x.ravel() for x in r]) @ np.array(s))


def _normal(J: Followed, residuals: Sequence[Array], tau: float, c: Coordinates, q: Array) -> tuple[Array, Array, Array]:
    """Return the information matrix for noise of the present variances, the cost's curvature with variances that follow, and its slope.

    Both are of Gauss and Newton; the second lacks what changes of the residual along itself change, which the variances absorb.
    """
    e, w = np.vstack(residuals), c.prior_weight**2
    precision = 1 / (rms(residuals) ** 2 * tau)
    H = np.tensordot(precision, J.gram, 1) + np.diag(w)
    H[np.diag_indices_from(H)] += 1e-9 * max(float(np.trace(H)) / max(len(H), 1), TINY)
    slopes = precision[:, None] * J.along(e)
    return H, H - tau / len(e) * slopes.T @ slopes, slopes.sum(0) + w * (q - c.prior_mean)


def _improving(
    problem: Problem, c: Coordinates, q: Array, H: Array, g: Array, cost: float, damping: float, horizon: float,
    cost_of: Callable[[Array, Sequence[Array]], float],
) -> tuple[Array, tuple[Array, ...], float, float] | None:
    """Return coordinates, residuals, cost and damping after a step that lowers the cost; None when none does."""
    growth, failed = 2.0, np.inf
    for _ in range(ATTEMPTS):
        while (size := float(np.linalg.norm(step := _damped(c, H, g, damping)))) > SHORTER * failed:
            damping, growth = damping * growth, 2 * growth
        moved = c.pack(c.unpack(q + step))
        residuals = weighted(problem, c.unpack(moved), horizon)
        new = cost_of(moved, residuals)
        if new < cost - 1e-12:
            return moved, residuals, new, damping / GROWTH if failed == np.inf else damping
        failed = size
    return None


def _damped(c: Coordinates, H: Array, g: Array, damping: float) -> Array:
    """Return a step, held to a length that keeps shape parameters in sight."""
    step = -np.linalg.solve(H + damping * np.eye(len(H)), g)
    step[: c.k] = np.clip(step[: c.k], -5, 5)
    step[c.k : c.shared] = np.clip(step[c.k : c.shared], -1.5, 1.5)
    return np.asarray(step)
