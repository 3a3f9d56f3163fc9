"""Does every output respond to the inputs at all? Columns of two machines, or of two days, do not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import signal, stats

from afdsvc.api.model import Model
from afdsvc.dataset.experiment import Run
from afdsvc.dataset.sample_checks import CheckFinding
from afdsvc.dataset.split import Split, still_readings
from afdsvc.errors import BadInput
from afdsvc.explain.check.gain import STOP
from afdsvc.explain.gap.decision import gap_test
from afdsvc.explain.gap.settings import GapSettings
from afdsvc.explain.gap.signals import ResidualSignals
from afdsvc.explain.noise.weighting import correlation_time
from afdsvc.explain.simulate.nominal import Nominal
from afdsvc.explain.simulate.simulator import Simulator
from afdsvc.lti.statespace import Array

CLEAR = 0.3  # smallest correlation with an input, or its size, at any lag, from which an output responds without a further test
SLOW = 0.5  # the same of a slow output, which chance reaches often, below which it is doubted
CHANCE = 1e-3  # probability with which the largest correlation of unrelated signals may count as clear
CAUSED = 0.5  # rms of what the model says the inputs cause, over that of the output, below which nothing is expected to show
REPEATS = 0.02  # share of the output that repeats with the excitation, from which it responds


def responding(nominal: Nominal, runs: Sequence[Run]) -> Iterator[CheckFinding]:
    """Yield a stop for every output that no flexible model predicts from the inputs better than from time-shifted ones.

    Asked only where the model says that the inputs cause most of the output, and where no controller feeds it back. Recordings that hold
    too few blocks for the answer are refused where the output, beside that, moves much less than a stable model says.
    """
    model = nominal.model
    if not model.inputs or any(r.W is not None or r.commanded for r in runs):
        return
    simulated = _simulated(nominal, runs)
    caused = [_caused(runs, simulated, j) for j in range(len(model.outputs))]
    correlations = [_correlation(runs, simulated, j) for j in range(len(model.outputs))]
    silent = [j for j, share in enumerate(caused) if not share < CAUSED and not correlations[j][1]]
    if not silent:
        return
    inputs = ", ".join(f"u_{v.name}" for v in model.inputs)
    if _stretches(runs) < GapSettings().needed_blocks:
        for j in silent:
            if nominal.plant.is_stable() and caused[j] > STOP:
                yield CheckFinding(
                    "stop", "response",
                    f"y_{model.outputs[j].name} is not correlated with the inputs, and the model says that they move it {caused[j]:.3g} times as much as it moves; "
                    "expected columns recorded together on the machine of the model, in its units",
                )
            elif correlations[j][0] < SLOW:
                yield _doubtful(model.outputs[j].name, inputs)
        return
    given = [ResidualSignals(r.Y[:, silent], r.U, r.U[:, :0], r.U[:, :0], r.dt, r.period) for r in runs]
    names = [model.outputs[j].name for j in silent]
    tested = gap_test(given, [], [v.name for v in model.inputs], names, [], np.random.default_rng(0))
    for i, name in enumerate(names):
        repeats = 0.0 if tested.repeats is None else tested.repeats[i]
        if tested.enough and tested.r2[i] < tested.threshold[i] and repeats < REPEATS:
            yield CheckFinding(
                "stop", "response",
                f"y_{name} does not respond to {inputs}: of the output, {100 * max(tested.r2[i], 0.0):.1f} % is predictable from the inputs, no more "
                "than from time-shifted ones; expected columns recorded together on the machine of the model",
            )
        elif not tested.enough and repeats < REPEATS and correlations[silent[i]][0] < SLOW:
            yield _doubtful(name, inputs)


def _doubtful(name: str, inputs: str) -> CheckFinding:
    return CheckFinding(
        "warning", "response",
        f"y_{name} is not clearly correlated with {inputs}, nor with what the model makes of them, and moves too slowly for a test of more; "
        "expected columns recorded together on the machine of the model: is this the right one?",
    )


def _simulated(nominal: Nominal, runs: Sequence[Run]) -> list[Array]:
    """Return what the model says the inputs cause, ``(n, p)`` for each run."""
    n, p = nominal.plant.order, nominal.plant.outputs
    simulator = Simulator(nominal, np.zeros((n, p)))
    return [r.shown(simulator.run(r, np.zeros(len(nominal.entries)), np.zeros(n), outputs_only=True).y) for r in runs]


def _caused(runs: Sequence[Run], simulated: Sequence[Array], j: int) -> float:
    """Return the rms of what the model says the inputs cause in an output, over that of the output; NaN where its simulation fails."""
    size = np.sqrt(np.mean([np.nanvar(r.Y[:, j]) for r in runs]))
    with np.errstate(all="ignore"):
        return float(np.sqrt(np.mean([np.var(y[:, j]) for y in simulated])) / size)


def _stretches(runs: Sequence[Run]) -> float:
    """Return how many stretches of four correlation times the inputs have: steps, one a recording, look alike when they are shifted."""
    moved = [r.U - r.U.mean(0) for r in runs if np.ptp(r.U, axis=0).any()]
    return sum(map(len, moved)) / (GapSettings().block_times * correlation_time(moved)) if moved else 0.0


def _correlation(runs: Sequence[Run], simulated: Sequence[Array], j: int) -> tuple[float, bool]:
    """Return the largest correlation of an output with what the model makes of the inputs, with an input or its size, at any lag in any recording
    and in all together, and whether one is clear.

    So are the changes of the output over the correlation time of the inputs: what integrates them wanders, and is correlated with nothing.
    """
    longest = min(len(r.U) for r in runs) // 2
    recordings, found = [[k] for k in range(len(runs))] + [list(range(len(runs)))], []
    for over in (0, int(np.clip(correlation_time([r.U - r.U.mean(0) for r in runs]), 1, longest))):
        outputs, causes = [], []
        for r, made in zip(runs, simulated, strict=True):
            y, own, u = _changes(r.Y[:, j], over), _changes(made[:, j], over), r.U[: len(r.U) - over] - r.U.mean(0)
            outputs.append(np.nan_to_num(y - np.nanmean(y)))
            causes.append(np.column_stack([own - own.mean(), u - u.mean(0), np.abs(u) - np.abs(u).mean(0)]))
        kinds = [i for i in range(causes[0].shape[1]) if all(np.isfinite(c[:, i]).all() for c in causes)]
        found += [_largest([outputs[k] for k in some], [causes[k][:, i] for k in some]) for some in recordings for i in kinds]
    return max([size for size, _ in found], default=0.0), any(clear for _, clear in found)


def _changes(x: Array, over: int) -> Array:
    """Return how much a signal changes over that many samples, itself for none."""
    return x[over:] - x[:-over] if over else x


def _largest(outputs: Sequence[Array], inputs: Sequence[Array]) -> tuple[float, bool]:
    """Return the largest correlation over all lags, and whether it is `CLEAR` and more than unrelated signals of these spectra reach by chance.

    The variance of a correlation of unrelated signals is the sum over lags of the product of their autocorrelations, over their length
    (Bartlett, "On the theoretical specification and sampling properties of autocorrelated time-series", 1946), that of its inverse hyperbolic tangent
    for large ones, too (Fisher, "On the probable error of a coefficient of correlation", 1921). Products of several recordings add up.
    """
    longest, powers = max(map(len, outputs)), np.array([[float(x @ x) for x in pair] for pair in zip(outputs, inputs, strict=True)])
    size = float(np.sqrt(np.prod(powers.sum(0))))
    if size == 0:
        return 0.0, False
    products, variance = np.zeros(2 * longest - 1), 0.0
    for y, u, power in zip(outputs, inputs, powers, strict=True):
        at = longest - len(y)
        products[at : at + 2 * len(y) - 1] += signal.correlate(y, u, method="fft")
        own = [signal.correlate(x, x, method="fft") for x in (y, u)]
        variance += max(float(own[0] @ own[1]), float(np.prod(power))) / len(y)
    largest = min(float(np.abs(products).max() / size), 1.0 - 1e-12)
    by_chance = float(np.tanh(stats.norm.isf(CHANCE / (2 * sum(map(len, outputs)))) * np.sqrt(variance) / size))
    return largest, largest > max(CLEAR, by_chance)


def refuse_still(model: Model, roles: Split) -> None:
    """Raise `BadInput` where a reading never moves in what is fitted or in what is held out: nothing could be fitted or shown there."""
    for runs, role in ((roles.train, "fitted"), (roles.heldout, "held out")):
        y = np.concatenate([r.Y for r in runs])
        for name, said in still_readings(model.outputs, y):
            raise BadInput(f"{', '.join(r.name for r in runs)}, {role}: y_{name} {said}")
