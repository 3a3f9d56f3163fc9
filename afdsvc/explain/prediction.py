"""The model played over a recording, the way its fit is shown: from the inputs alone, in closed loop, or predicted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.explain.baseline import calm_gain
from afdsvc.explain.nominal import Nominal
from afdsvc.explain.objective import Point
from afdsvc.explain.simulator import Effect, Simulator
from afdsvc.lti.statespace import Array

WAYS = ("from the inputs", "in closed loop", "predicted")
FORGETS = 3.0  # time constants of the slowest pole that must fit into a recording to simulate from the inputs alone


@dataclass(frozen=True, slots=True, eq=False)
class Player:
    """Plays a model: one of `WAYS`, with the simulator that does it."""

    way: str
    simulator: Simulator

    def outputs(self, run: Run, point: Point) -> Array:
        """Return the simulated outputs ``(n, p)`` from the initial state that fits the recording best."""
        return self.started(run, point.theta, point.effects)[1]

    def started(self, run: Run, theta: Array, effects: Sequence[Effect]) -> tuple[Array, Array]:
        """Return the fitted initial state and the outputs simulated from it.

        It is looked for from rest and from the state that fits the model without the effects: a law that is not smooth may not
        show the way from rest.
        """
        sizes = np.nanstd(run.Y, axis=0)
        sizes = np.where(sizes > 0, sizes, 1.0)

        def play(x0: Array) -> Array:
            return self.simulator.run(run, theta, x0, effects, closed=self.way == WAYS[1]).y / sizes

        starts = [np.zeros(self.simulator.nominal.plant.order), *([self.started(run, theta, ())[0]] if effects else [])]
        x0, y, _ = min((_best_state(play, run.Y / sizes, x) for x in starts), key=lambda found: found[2])
        return x0, y * sizes


def player(nominal: Nominal, runs: Sequence[Run], start: Point, ramped: bool) -> Player:
    """Choose the way: from the inputs where the plant forgets its start, in closed loop where the controller is known."""
    n, p = nominal.plant.order, nominal.plant.outputs
    plain = Simulator(nominal, np.zeros((n, p)), ramped)
    if _forgets(nominal, min(len(r) for r in runs) * nominal.dt):
        return Player(WAYS[0], plain)
    if all(r.W is not None for r in runs) and not nominal.plant.D.any():
        return Player(WAYS[1], plain)
    return Player(WAYS[2], calm_gain(nominal, runs, _rested(start, runs), ramped)[0])


def _rested(point: Point, runs: Sequence[Run]) -> Point:
    n = len(point.x0[0]) if point.x0 else 0
    return Point(point.theta, tuple(np.zeros(n) for _ in runs), point.effects)


def _forgets(nominal: Nominal, seconds: float) -> bool:
    poles = nominal.plant.poles()
    if not poles.size:
        return True
    rates = -np.log(np.maximum(np.abs(poles), 1e-12)) / nominal.plant.dt if nominal.plant.discrete else -poles.real
    return bool(rates.min() * seconds > FORGETS)


def _best_state(play: Callable[[Array], Array], Y: Array, x0: Array, passes: int = 2) -> tuple[Array, Array, float]:
    """Gauss-Newton in the initial state, steps shortened while they do not help; returns it, the outputs and the cost."""
    y = play(x0)
    cost = _cost(Y - y)
    for _ in range(passes):
        J = np.column_stack([(play(x0 + 1e-3 * unit) - y).ravel() / 1e-3 for unit in np.eye(len(x0))])
        e = np.nan_to_num(Y - y).ravel()
        J[~np.isfinite(J).all(1)] = 0.0
        scale = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
        step = np.linalg.lstsq(J / scale, e, rcond=1e-6)[0] / scale
        found = _along(play, Y, x0, step, cost)
        if found is None:
            break
        fall, (x0, y, cost) = cost - found[2], found
        if fall < 1e-6 * cost:
            break
    return x0, y, cost


def _along(play: Callable[[Array], Array], Y: Array, x0: Array, step: Array, cost: float) -> tuple[Array, Array, float] | None:
    for shrink in (1.0, 0.3, 0.03):
        y = play(x0 + shrink * step)
        new = _cost(Y - y)
        if new < cost:
            return x0 + shrink * step, y, new
    return None


def _cost(e: Array) -> float:
    return float(np.nansum(e**2)) if np.isfinite(e).any() else np.inf


def nrmse(measured: Array, simulated: Array) -> float:
    """Return ``|y - yhat| / |y - mean|`` of one output over the samples that were measured; infinite where simulation left."""
    seen = np.isfinite(measured)
    y, e = measured[seen], (measured - simulated)[seen]
    if not np.isfinite(e).all():
        return float("inf")
    return float(np.sqrt((e**2).sum() / max(((y - y.mean()) ** 2).sum(), 1e-300)))
