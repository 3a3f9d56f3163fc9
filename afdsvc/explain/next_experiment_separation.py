"""How far apart two rivals would be on a burst, after each has done its best to imitate the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from afdsvc.api.bursts import Limits
from afdsvc.dataset.experiment import Run
from afdsvc.explain.baseline import Baseline
from afdsvc.explain.next_experiment_plans import Plan
from afdsvc.explain.noise import positive
from afdsvc.explain.objective import Point, small_step, tangent
from afdsvc.explain.simulator import Effect, controller_of
from afdsvc.lti.statespace import Array
from afdsvc.stats.ar_noise import white

ROOM = 2.2  # largest output over what was recorded, where no limits are given
THETA_STEP = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """A rival with what is known of its numbers: information ``H (k, k)`` in units of ``scales (k,)``, theta first, then effects."""

    point: Point
    H: Array
    scales: Array


@dataclass(frozen=True, slots=True, eq=False)
class Rehearsal:
    """Rivals ready to be played on bursts; ``closed`` says whether the loop is closed by the known controller.

    ``responses`` keeps what the model's own numbers do to the outputs per burst shape: nearly the same for every rival, and
    proportional to the level.
    """

    base: Baseline
    rivals: tuple[_Known, ...]
    closed: bool
    responses: dict[tuple[object, ...], Array] = field(default_factory=dict)

    def separation(self, plan: Plan) -> float:
        """Return the distance of the first rival from the closest other, in standard deviations of the noise."""
        run = _run(self.base, plan)
        seen = [self._seen(run, r.point, plan) for r in self.rivals]
        if not all(np.isfinite(s).all() for s in seen):
            return 0.0
        repeats = plan.burst.samples / plan.period - 1.0
        jacobians = [self._jacobian(run, r, s, plan) for r, s in zip(self.rivals, seen, strict=True)]
        apart = []
        for k in range(1, len(self.rivals)):
            d = seen[0] - seen[k]
            both = (unlike(d, jacobians[i], self.rivals[i].H, repeats) for i in (0, k))
            apart.append(min(both))
        return float(np.sqrt(max(min(apart), 0.0)))

    def allowed(self, plan: Plan, limits: Limits | None) -> bool:
        """Whether the first rival keeps the outputs and inputs within the limits (default: not far beyond those recorded)."""
        run = _run(self.base, plan)
        found = self._played(run, self.rivals[0].point)
        if not np.isfinite(found[0]).all():
            return False
        seen = self.base.objective.runs
        y = limits.output if limits else ROOM * np.max([np.nanmax(np.abs(r.Y), axis=0) for r in seen], axis=0)
        u = limits.input if limits else np.full(found[1].shape[1], np.inf)
        return bool((np.abs(found[0]).max(0) <= y).all() and (np.abs(found[1]).max(0) <= u).all())

    def _played(self, run: Run, point: Point) -> tuple[Array, Array]:
        x0 = np.zeros(self.base.nominal.plant.order)
        s = self.base.objective.simulator.run(run, point.theta, x0, point.effects, closed=self.closed, free=True)
        return s.y, s.u

    def _seen(self, run: Run, point: Point, plan: Plan) -> Array:
        y, _ = self._played(run, point)
        return np.asarray(self.base.objective.whitener(y)[-plan.period :].ravel())

    def _jacobian(self, run: Run, rival: _Known, here: Array, plan: Plan) -> Array:
        own = [(self._seen(run, p, plan) - here) / step for p, step in _moved(rival.point)]
        return np.column_stack([self._response(run, rival, here, plan), *own]) * rival.scales

    def _response(self, run: Run, rival: _Known, here: Array, plan: Plan) -> Array:
        """Return the derivative by theta, ``(numbers, k)``, from the first rival and level that asked for this burst shape."""
        key = (plan.inputs, plan.band)
        if key not in self.responses:
            columns = [np.zeros((here.size, 0))]
            for j in range(len(rival.point.theta)):
                theta = rival.point.theta.copy()
                theta[j] += THETA_STEP
                columns.append((self._seen(run, replace(rival.point, theta=theta), plan) - here)[:, None] / THETA_STEP)
            self.responses[key] = np.hstack(columns) / plan.level
        return self.responses[key] * plan.level


def _moved(point: Point) -> list[tuple[Point, float]]:
    """Return the point with every number of its effects moved by a little, and by how much."""
    out = []
    for n, effect in enumerate(point.effects):
        for j, c in enumerate(effect.hypothesis.parameters):
            step = small_step(effect.values[j], c.scale, c.low, c.high) or 1.0
            values = effect.values.copy()
            values[j] += step if c.free else 0.0
            effects = (*point.effects[:n], Effect(effect.hypothesis, values), *point.effects[n + 1 :])
            out.append((replace(point, effects=effects), step))
    return out


def unlike(d: Array, J: Array, H: Array, repeats: float) -> float:
    """Return the part of the squared distance that the numbers behind J, known to H, cannot make up for."""
    c = J.T @ d
    return repeats * float(d @ d - c @ np.linalg.solve(J.T @ J + H / repeats, c))


def rehearsal(base: Baseline, points: Sequence[Point]) -> Rehearsal | None:
    """Return the rivals ready to be played; None without a known controller on a plant that is not stable."""
    closed = controller_of(base.nominal, base.objective.runs[0].dt) is not None
    if not closed and not _stable(base):
        return None
    judged = _by_noise(base, points[0])
    return Rehearsal(judged, tuple(_known(judged, p) for p in points), closed)


def _by_noise(base: Baseline, point: Point) -> Baseline:
    """Return the baseline with residuals in units of the noise: as measured apart, else what the first rival leaves."""
    whitener = base.floor.whitener
    if not base.floor.known:
        left = np.vstack([base.objective.residual(i, point.theta, x0, point.effects) for i, x0 in enumerate(point.x0)])
        whitener = white(positive((left**2).mean(0)) * base.memory)
    return replace(base, objective=replace(base.objective, whitener=whitener))


def _stable(base: Baseline) -> bool:
    poles = base.nominal.plant.poles()
    return bool((np.abs(poles) < 1).all() if base.nominal.plant.discrete else (poles.real < 0).all())


def _known(base: Baseline, point: Point) -> _Known:
    """Return what the recordings so far say about the rival's numbers, its initial states given up."""
    t = tangent(base.objective, point)
    k, states = len(point.theta), sum(len(x) for x in point.x0)
    keep = [*range(k), *range(k + states, t.r.shape[1])]
    lost = list(range(k, k + states))
    H = t.r.T @ t.r
    inner = H[np.ix_(lost, lost)] + 1e-9 * np.eye(states)
    cross = H[np.ix_(keep, lost)]
    left = H[np.ix_(keep, keep)] - cross @ np.linalg.solve(inner, cross.T)
    return _Known(point, left + 1e-9 * np.eye(len(keep)), t.scales[keep])


def _run(base: Baseline, plan: Plan) -> Run:
    """Return two periods of the burst as a run: one to settle, one to compare."""
    seen = base.objective.runs[0]
    dt, n = seen.dt, 2 * plan.period
    t = np.arange(n) * dt
    alpha = np.zeros((n, plan.burst.inputs))
    for line in plan.burst.lines:
        alpha[:, line.input] += line.amplitude * np.sin(line.omega * t + line.phase)
    aux = np.tile(seen.AUX.mean(0), (n, 1))
    if plan.speed is not None:
        for name, values in (("speed", np.full(n, plan.speed)), ("angle", np.mod(plan.speed * t, 2 * np.pi))):
            if name in seen.aux:
                aux[:, seen.aux.index(name)] = values
    nothing = np.zeros((n, base.nominal.plant.outputs))
    return Run(plan.burst.name, dt, 0.0, alpha, nothing, aux, nothing, seen.aux, W=alpha, commanded=True)
