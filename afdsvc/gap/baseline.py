"""Where the search starts: predictor gain, noise, and the nominal model refitted within what its owner allows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.gap import noise
from afdsvc.gap.fit import moved
from afdsvc.gap.nominal import Nominal
from afdsvc.gap.objective import Objective, Point, Tangent, tangent
from afdsvc.gap.runs import Run
from afdsvc.gap.simulator import Simulator
from afdsvc.gap.whitening import white
from afdsvc.lti.statespace import Array

WORTH_A_GAIN = 10.0  # gain of log-likelihood that justifies process noise instead of output noise alone


@dataclass(frozen=True, slots=True, eq=False)
class Baseline:
    """The objective on the training runs and the point the next effect is added to.

    ``ratio`` is the process noise the predictor assumes, as a share of the input's power.
    """

    objective: Objective
    point: Point
    floor: noise.Floor
    ratio: float

    @property
    def nominal(self) -> Nominal:
        """The nominal model."""
        return self.objective.simulator.nominal


def start_point(nominal: Nominal, runs: Sequence[Run]) -> Point:
    """Return the nominal parameters with every run starting from rest."""
    return Point(np.zeros(len(nominal.entries)), tuple(np.zeros(nominal.plant.order) for _ in runs))


def baseline(nominal: Nominal, runs: Sequence[Run], point: Point | None = None) -> Baseline:
    """Choose the predictor gain, measure the noise and refit the nuisance, twice, so each rests on the other."""
    point = point or start_point(nominal, runs)
    for _ in range(2):
        simulator, ratio, point = choose_gain(nominal, runs, point)
        objective = Objective(simulator, tuple(runs), white(np.ones(nominal.plant.outputs)))
        found = noise.floor(runs, raw(objective, point))
        objective = replace(objective, whitener=found.whitener)
        point = settle(objective, point)
        found = noise.floor(runs, raw(objective, point))
    objective = replace(objective, whitener=found.whitener)
    return Baseline(objective, settle(objective, point, 2), found, ratio)


def raw(objective: Objective, point: Point) -> list[Array]:
    """Return the residuals before whitening, one ``(n, p)`` per run."""
    return [objective.residual(i, point.theta, x0, point.effects) for i, x0 in enumerate(point.x0)]


def settle(objective: Objective, point: Point, iterations: int = 6, states_only: bool = False) -> Point:
    """Return the point refitted in its nuisance by Gauss-Newton with step halving."""
    for _ in range(iterations):
        t = tangent(objective, point, states_only)
        before = float(t.full @ t.full)
        point, after = _descend(objective, t, before, states_only)
        if before - after < 1e-3 * before and before - after < 1.0:
            break
    return point


def _descend(objective: Objective, t: Tangent, before: float, states_only: bool) -> tuple[Point, float]:
    step = t.shift(t.full)
    for factor in (1.0, 0.5, 0.2, 0.05, 0.01):
        new = moved_states(t.point, factor * step) if states_only else moved(t.point, factor * step)
        cost = full_cost(objective, new, states_only)
        if cost < before:
            return new, cost
    return t.point, before


def moved_states(point: Point, step: Array) -> Point:
    """Return a point whose initial states alone have moved."""
    at, x0 = 0, []
    for x in point.x0:
        x0.append(x + step[at : at + len(x)])
        at += len(x)
    return replace(point, x0=tuple(x0))


def full_cost(objective: Objective, point: Point, states_only: bool = False) -> float:
    """Return the sum of squares with the prior of theta."""
    data = objective.vector(point)
    return float(data @ data) + (0.0 if states_only else float(point.theta @ point.theta))


def choose_gain(nominal: Nominal, runs: Sequence[Run], point: Point) -> tuple[Simulator, float, Point]:
    """Return the simulator with the predictor gain whose residual is likeliest, its ratio, and the fitted initial states."""
    sizes, drive = _sizes(runs)
    plant = nominal.at(point.theta)
    found: list[tuple[float, float, Simulator, Point]] = []
    for ratio in noise.RATIOS:
        gain = noise.predictor_gain(plant, nominal, ratio, sizes, drive)
        if gain is None:
            continue
        simulator = Simulator(nominal, gain)
        objective = Objective(simulator, tuple(runs), white(sizes**2))
        start = settle(objective, point, 1, states_only=True)
        found.append((_misfit(runs, raw(objective, start)), ratio, simulator, start))
    if not found:
        raise BadInput(f"model '{nominal.model.name}': no predictor is stable; a model whose unstable modes are seen at the outputs is wanted")
    best = min(found, key=lambda f: f[0])
    first = found[0]
    chosen = first if first[1] == 0.0 and first[0] < best[0] + WORTH_A_GAIN else best
    return chosen[2], chosen[1], chosen[3]


def _sizes(runs: Sequence[Run]) -> tuple[Array, Array]:
    """Return the output noise guessed from sample-to-sample roughness and the rms of the inputs."""
    rough = np.sqrt(np.mean([_roughness(r.Y) for r in runs], axis=0))
    whole = np.sqrt(np.mean([np.nanvar(r.Y, axis=0) for r in runs], axis=0))
    drive = np.sqrt(np.mean([(r.U**2).mean(0) for r in runs], axis=0))
    return np.maximum(rough, 1e-7 * np.maximum(whole, 1e-12 * max(whole.max(), 1e-300))), np.maximum(drive, 1e-12 * max(drive.max(), 1e-300))


def _roughness(Y: Array) -> Array:
    """Variance of the fourth difference over what white noise of variance 1 would give (70)."""
    d = np.diff(Y, 4, axis=0)
    return np.asarray(np.nanmean(d**2, axis=0) / 70)


def _misfit(runs: Sequence[Run], residuals: Sequence[Array]) -> float:
    """Half the samples times the log determinant of the residual's covariance: of what does not repeat, where it can be told."""
    pieces = noise.wandering(runs, residuals) or [np.nan_to_num(e) for e in residuals]
    everything = np.vstack(pieces)
    if not np.isfinite(everything).all() or np.abs(everything).max() > 1e100:
        return np.inf
    cov = everything.T @ everything / len(everything)
    sign, logdet = np.linalg.slogdet(cov)
    return float(len(everything) / 2 * logdet) if sign > 0 else np.inf
