"""Does every output respond to the inputs at all? Columns of two machines, or of two days, do not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import signal

from afdsvc.dataset.experiment import Run
from afdsvc.dataset.finding import Finding
from afdsvc.explain.gap.decision import gap
from afdsvc.explain.gap.signals import Signals
from afdsvc.explain.simulate.nominal import Nominal
from afdsvc.explain.simulate.simulator import Simulator
from afdsvc.lti.statespace import Array

CLEAR = 0.3  # largest correlation with an input, or its size, at any lag, from which an output responds without a further test
CAUSED = 0.5  # rms of what the model says the inputs cause, over that of the output, below which nothing is expected to show
REPEATS = 0.02  # share of the output that repeats with the excitation, from which it responds


def response(nominal: Nominal, runs: Sequence[Run]) -> Iterator[Finding]:
    """Yield a stop for every output that no flexible model predicts from the inputs better than from time-shifted ones.

    Asked only where the model says that the inputs cause most of the output, where no controller feeds it back, and where
    the recordings hold enough blocks for the answer.
    """
    model = nominal.model
    if not model.inputs or any(r.W is not None or r.commanded for r in runs):
        return
    silent = [j for j in range(len(model.outputs)) if _expected(nominal, runs, j) and _correlation(runs, j) < CLEAR]
    if not silent:
        return
    given = [Signals(r.Y[:, silent], r.U, r.U[:, :0], r.U[:, :0], r.dt, r.period) for r in runs]
    names = [model.outputs[j].name for j in silent]
    found = gap(given, [], [v.name for v in model.inputs], names, [], np.random.default_rng(0))
    inputs = ", ".join(f"u_{v.name}" for v in model.inputs)
    for i, name in enumerate(names):
        repeats = 0.0 if found.repeats is None else found.repeats[i]
        if found.enough and found.r2[i] < found.threshold[i] and repeats < REPEATS:
            yield Finding(
                "stop", "response",
                f"y_{name} does not respond to {inputs}: of the output, {100 * max(found.r2[i], 0.0):.1f} % is predictable from the inputs, no more "
                "than from time-shifted ones; expected columns recorded together on the machine of the model",
            )


def _expected(nominal: Nominal, runs: Sequence[Run], j: int) -> bool:
    """Whether the model says that the inputs cause most of the output."""
    n, p = nominal.plant.order, nominal.plant.outputs
    simulator = Simulator(nominal, np.zeros((n, p)))
    caused = [simulator.run(r, np.zeros(len(nominal.entries)), np.zeros(n)).y[:, j] for r in runs]
    size = np.sqrt(np.mean([np.nanvar(r.Y[:, j]) for r in runs]))
    with np.errstate(all="ignore"):
        return not np.sqrt(np.mean([np.var(c) for c in caused])) < CAUSED * size


def _correlation(runs: Sequence[Run], j: int) -> float:
    """Return the largest correlation of an output with an input or its size over all lags, in any recording."""
    return max(
        _largest(np.nan_to_num(r.Y[:, j] - np.nanmean(r.Y[:, j])), x) for r in runs for u in (r.U - r.U.mean(0)).T for x in (u, np.abs(u) - np.abs(u).mean())
    )


def _largest(y: Array, u: Array) -> float:
    size = np.linalg.norm(y) * np.linalg.norm(u)
    return float(np.abs(signal.correlate(y, u, method="fft")).max() / size) if size > 0 else 0.0
