"""Where the search starts: predictor gain, noise, and the nominal model refitted within what its owner allows.

Two situations are told apart. *Noise-limited*: the excitation repeats, so the noise is known apart from the model, and the
residual is of its size. Then the predictor and the whitening are those of the noise, and sums of squares are likelihoods.
*Model-limited*: the residual towers over the noise, or the noise is not known. Weighting by the noise would then stress
whatever the model gets wrong at the quietest frequencies, so plain simulation is compared (corrected only slowly where
the plant would drift away), and the residual itself, with its own correlation time, is the measure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.errors import BadInput
from afdsvc.explain import noise
from afdsvc.explain.nominal import Nominal
from afdsvc.explain.objective import Objective, Point
from afdsvc.explain.settle import raw, settle
from afdsvc.explain.simulator import Simulator
from afdsvc.lti.statespace import Array
from afdsvc.stats.ar_noise import correlation_time, white

WORTH_A_GAIN = 10.0  # gain of log-likelihood that justifies process noise instead of output noise alone
ABSENT = 1e-6  # weight of an input at which no noise enters
FAR_ABOVE = 10.0  # power of the residual over the noise's from which on the model limits, not the noise


@dataclass(frozen=True, slots=True, eq=False)
class Baseline:
    """The objective on the training runs and the point the next effect is added to.

    ``ratio`` is the process noise the predictor assumes, as a share of the input's power; ``limited`` says whether noise
    limits ("noise") or the model ("model"); ``memory`` how many samples of the residual count as one in the latter case.
    """

    objective: Objective
    point: Point
    floor: noise.Floor
    ratio: float
    limited: str
    memory: float = 1.0

    @property
    def nominal(self) -> Nominal:
        """The nominal model."""
        return self.objective.simulator.nominal

    @property
    def counts(self) -> float:
        """How many independent numbers the training residual is worth."""
        return self.objective.samples / self.memory


def start_point(nominal: Nominal, runs: Sequence[Run]) -> Point:
    """Return the nominal parameters with every run starting from rest."""
    return Point(np.zeros(len(nominal.entries)), tuple(np.zeros(nominal.plant.order) for _ in runs))


def baseline(nominal: Nominal, runs: Sequence[Run], point: Point | None = None) -> Baseline:
    """Choose the predictor, measure the noise and refit the nuisance, from the nominal model or from ``point``."""
    point = point or start_point(nominal, runs)
    calm = _model_limited(nominal, runs, point)
    if not calm.floor.known or _excess(calm) >= FAR_ABOVE:
        return calm
    found = _noise_limited(nominal, runs, calm.point) or calm
    if found.ratio < calm.ratio and _excess(found) >= FAR_ABOVE:  # a drifting plant goes elsewhere than the machine did: held to it
        return _noise_limited(nominal, runs, calm.point, calm) or calm
    return found


def again(base: Baseline, point: Point) -> Baseline:
    """Return the baseline at a point with more effects; the predictor is chosen anew only where it may have to change."""
    if base.limited != "noise" or base.ratio > 0:
        return baseline(base.nominal, base.objective.runs, point)
    floor = noise.floor(base.objective.runs, raw(base.objective, point))
    objective = replace(base.objective, whitener=floor.whitener)
    return replace(base, objective=objective, point=settle(objective, point, 2), floor=floor)


def as_stated(base: Baseline) -> Baseline:
    """Return the baseline with every number of the model held where its owner stated it, and no effects."""
    rigid = replace(base.nominal, entries=())
    objective = replace(base.objective, simulator=replace(base.objective.simulator, nominal=rigid))
    point = settle(objective, Point(np.zeros(0), base.point.x0), 2, states_only=True)
    return replace(base, objective=objective, point=point)


def _excess(base: Baseline) -> float:
    """Return the power of the residual over that of the noise, the larger of the outputs'."""
    power = np.mean([(e**2).mean(0) for e in raw(base.objective, base.point)], axis=0)
    return float(np.max(power / base.floor.sd**2))


def _noise_limited(nominal: Nominal, runs: Sequence[Run], point: Point, held: Baseline | None = None) -> Baseline | None:
    """Return the baseline with the likeliest predictor, or that of ``held``; None where the noise is not known."""
    for _ in range(2):
        if held is None:
            simulator, ratio, point = likeliest_gain(nominal, runs, point)
        else:
            simulator, ratio = held.objective.simulator, held.ratio
        objective = Objective(simulator, tuple(runs), white(np.ones(nominal.plant.outputs)))
        found = noise.floor(runs, raw(objective, point))
        if not found.known:
            return None
        objective = replace(objective, whitener=found.whitener)
        point = settle(objective, point)
    found = noise.floor(runs, raw(objective, point))
    objective = replace(objective, whitener=found.whitener)
    return Baseline(objective, settle(objective, point, 2), found, ratio, "noise")


def _model_limited(nominal: Nominal, runs: Sequence[Run], point: Point) -> Baseline:
    """Return the baseline for held inputs, or for smooth ones where the inputs may be and that explains more."""
    held = _calm(nominal, runs, point, ramped=False)
    if nominal.plant.discrete or nominal.model.controller is not None or any(_driven(r) for r in runs):
        return held
    smooth = _calm(nominal, runs, point, ramped=True)
    return min(held, smooth, key=power)


def _driven(run: Run) -> bool:
    """Whether the input comes from a controller, which holds it."""
    return run.W is not None or bool(np.ptp(run.REF, axis=0).max(initial=0.0) > 0) or run.commanded


def power(base: Baseline) -> float:
    """Return the power of the residual, every output in units of its reading's spread, summed over all samples."""
    scale = np.sqrt(noise.positive(np.mean([np.nanvar(r.Y, axis=0) for r in base.objective.runs], axis=0)))
    return float(sum(((e / scale) ** 2).sum() for e in raw(base.objective, base.point)))


def _calm(nominal: Nominal, runs: Sequence[Run], point: Point, ramped: bool) -> Baseline:
    return _weighed(nominal, runs, *calm_gain(nominal, runs, point, ramped))


def corrected(base: Baseline, ratio: float) -> Baseline | None:
    """Return the baseline of a model that limits, refitted with the correction of another ratio; None where none is stable."""
    runs, point = base.objective.runs, base.point
    simulator = _predictor(base.nominal, point, ratio, *_sizes(runs), base.objective.simulator.ramped)
    return None if simulator is None else _weighed(base.nominal, runs, simulator, ratio, point)


def _weighed(nominal: Nominal, runs: Sequence[Run], simulator: Simulator, ratio: float, point: Point) -> Baseline:
    """Return the baseline whose measure is its own residual, with its correlation time."""
    objective = Objective(simulator, tuple(runs), white(np.ones(nominal.plant.outputs)))
    memory = 1.0
    for _ in range(2):
        residuals = raw(objective, point)
        scale = noise.positive(np.mean([(e**2).mean(0) for e in residuals], axis=0))
        memory = float(np.mean([correlation_time(e / np.sqrt(scale)) for e in residuals]))
        objective = replace(objective, whitener=white(scale * memory))
        point = settle(objective, point)
    return Baseline(objective, point, noise.floor(runs, raw(objective, point)), ratio, "model", memory)


def likeliest_gain(nominal: Nominal, runs: Sequence[Run], point: Point) -> tuple[Simulator, float, Point]:
    """Return the simulator whose predictor leaves the least of what does not repeat, its ratio, and fitted initial states.

    Every second ratio is tried, then the neighbours of the best.
    """
    sizes, drive = _sizes(runs)
    tried: dict[float, tuple[float, Simulator, Point]] = {}

    def attempt(ratio: float) -> None:
        simulator = _predictor(nominal, point, ratio, sizes, drive)
        if simulator is not None and ratio not in tried:
            objective = Objective(simulator, tuple(runs), white(sizes**2))
            start = settle(objective, point, 1, states_only=True)
            tried[ratio] = _misfit(runs, raw(objective, start)), simulator, start

    for ratio in noise.RATIOS[::2]:
        attempt(ratio)
    _demand(nominal, tried)
    centre = noise.RATIOS.index(min(tried, key=lambda r: tried[r][0]))
    for k in (centre - 1, centre + 1):
        if 0 <= k < len(noise.RATIOS):
            attempt(noise.RATIOS[k])
    best = min(tried, key=lambda r: tried[r][0])
    if 0.0 in tried and not tried[0.0][1].gain.any() and tried[0.0][0] < tried[best][0] + WORTH_A_GAIN:
        best = 0.0
    return tried[best][1], best, tried[best][2]


def agitation(base: Baseline) -> Array:
    """Return, for every input, by how much (in log likelihood) noise that enters there alone improves on none, at its best strength.

    Asked at the strengths near that of the predictor.
    """
    runs, (sizes, drive) = base.objective.runs, _sizes(base.objective.runs)

    def misfit(ratio: float, weights: Array) -> float:
        simulator = _predictor(base.nominal, base.point, ratio, sizes, drive * weights)
        if simulator is None:
            return np.inf
        objective = Objective(simulator, runs, white(sizes**2))
        return _misfit(runs, raw(objective, settle(objective, base.point, 1, states_only=True)))

    near = [base.ratio * factor for factor in (0.1, 1.0, 10.0)]
    alone = np.maximum(np.eye(len(drive)), ABSENT)
    return misfit(0.0, np.ones(len(drive))) - np.array([min(misfit(ratio, weights) for ratio in near) for weights in alone])


def calm_gain(nominal: Nominal, runs: Sequence[Run], point: Point, ramped: bool = False) -> tuple[Simulator, float, Point]:
    """Return the weakest predictor that forgets within a twentieth of a run, but not faster than the excitation's lower edge."""
    longest = max(len(r) for r in runs) * nominal.dt
    wanted = max(20 / longest, 0.5 * lower_edge(runs))
    sizes, drive = _sizes(runs)
    found: dict[float, Simulator] = {}
    for ratio in noise.RATIOS:
        simulator = _predictor(nominal, point, ratio, sizes, drive, ramped)
        if simulator is not None:
            found[ratio] = simulator
            if _slowest(simulator) >= (wanted if simulator.gain.any() else 3 / longest):
                break
    _demand(nominal, found)
    ratio, simulator = list(found.items())[-1]
    objective = Objective(simulator, tuple(runs), white(sizes**2))
    return simulator, ratio, settle(objective, point, 1, states_only=True)


def _predictor(
    nominal: Nominal, point: Point, ratio: float, sizes: Array, drive: Array, ramped: bool = False
) -> Simulator | None:
    gain = noise.predictor_gain(nominal.at(point.theta), nominal, ratio, sizes, drive)
    return None if gain is None else Simulator(nominal, gain, ramped)


def _demand(nominal: Nominal, found: Mapping[float, object]) -> None:
    if not found:
        raise BadInput(
            f"model '{nominal.model.name}': no predictor is stable; a model whose unstable modes are seen at the outputs is wanted"
        )


def _slowest(simulator: Simulator) -> float:
    """Return the rate [rad/s] of the predictor's slowest mode."""
    nominal = simulator.nominal
    s = nominal.steps(np.zeros(len(nominal.entries)))
    a = np.linalg.matrix_power(s.phi, s.nsub) - simulator.gain @ nominal.plant.C
    size = np.abs(np.linalg.eigvals(a)).max(initial=0.0)
    return float(-np.log(max(size, 1e-300)) / nominal.dt)


def lower_edge(runs: Sequence[Run]) -> float:
    """Return the angular frequency [rad/s] below which 2 % of the input's power about its mean lies."""
    edges = []
    for r in runs:
        power = (np.abs(np.fft.rfft(r.U - r.U.mean(0), axis=0)) ** 2).sum(1)
        share = np.cumsum(power) / max(float(power.sum()), 1e-300)
        edges.append(2 * np.pi * int(np.searchsorted(share, 0.02)) / (len(r) * r.dt))
    return float(min(edges))


def _sizes(runs: Sequence[Run]) -> tuple[Array, Array]:
    """Return the output noise guessed from sample-to-sample roughness and the rms of the inputs."""
    rough = np.sqrt(np.mean([_roughness(r.Y) for r in runs], axis=0))
    whole = np.sqrt(np.mean([np.nanvar(r.Y, axis=0) for r in runs], axis=0))
    drive = np.sqrt(np.mean([(r.U**2).mean(0) for r in runs], axis=0))
    least = 1e-7 * np.maximum(whole, 1e-12 * max(float(whole.max()), 1e-300))
    return np.maximum(rough, least), np.maximum(drive, 1e-12 * max(float(drive.max()), 1e-300))


def _roughness(Y: Array) -> Array:
    """Variance of the fourth difference over what white noise of variance 1 would give (70)."""
    d = np.diff(Y, 4, axis=0)
    return np.asarray(np.nanmean(d**2, axis=0) / 70)


def _misfit(runs: Sequence[Run], residuals: Sequence[Array]) -> float:
    """Half the samples times the log determinant of the covariance of what does not repeat."""
    pieces = noise.wandering(runs, residuals) or [np.nan_to_num(e) for e in residuals]
    everything = np.vstack(pieces)
    if not np.isfinite(everything).all() or np.abs(everything).max() > 1e100:
        return np.inf
    cov = everything.T @ everything / len(everything)
    sign, logdet = np.linalg.slogdet(cov)
    return float(len(everything) / 2 * logdet) if sign > 0 else np.inf
