"""What the gap test reads: residual, inputs and simulated states of each recording, checked and centred."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array

#: Samples below which no block holds more than a few.
LEAST_SAMPLES = 100
#: Names of outputs, inputs, states, aux, in this order.
Names = Sequence[Sequence[str]]


@dataclass(frozen=True, slots=True, eq=False)
class ResidualSignals:
    """One recording.

    Attributes
    ----------
    residual : (n, p)
        Measured minus simulated output, NaN where a reading is missing. The simulation runs from the inputs only: no measured
        output may enter its states, or past noise predicts the residual.
    inputs, states, aux : (n, m), (n, k), (n, a)
        Inputs, states of the simulation, other measured signals that do not depend on the outputs' noise. Columns may be none.
    dt : float
        Sample time [s].
    period : int
        Period of the excitation [samples], 0 when it does not repeat.
    reference : (n, r), optional
        Signals from outside a closed loop (reference, injected burst). In a closed loop the inputs hold the noise of the
        outputs; where a reference is given, inputs and states are replaced by what it explains of them.
    """

    residual: Array
    inputs: Array
    states: Array
    aux: Array
    dt: float
    period: int = 0
    reference: Array | None = None

    @property
    def columns(self) -> Array:
        """Inputs, states and aux side by side, ``(n, m + k + a)``."""
        return np.hstack([self.inputs, self.states, self.aux])

    def __len__(self) -> int:
        return len(self.residual)


def check_signals(recordings: Sequence[ResidualSignals], names: Names) -> None:
    """Raise `BadInput` unless all recordings have the columns named (outputs, inputs, states, aux) and finite numbers."""
    if not recordings:
        raise BadInput("gap test: no recordings; expected at least one")
    for i, r in enumerate(recordings):
        arrays = zip(("residual", "inputs", "states", "aux"), (r.residual, r.inputs, r.states, r.aux), names, strict=True)
        for what, array, expected in arrays:
            _columns(f"gap test, recording {i + 1}", what, array, expected, len(r))
    known = np.vstack([np.isfinite(r.residual) for r in recordings])
    if len(known) < LEAST_SAMPLES:
        raise BadInput(f"gap test: {len(known)} samples in all recordings; expected at least {LEAST_SAMPLES}")
    for name, share in zip(names[0], known.mean(0), strict=True):
        if known.all(1).mean() < 0.5 * share or not share:
            raise BadInput(
                f"gap test: output '{name}' has {100 * share:.3g} % of its readings, all outputs together {100 * known.all(1).mean():.3g} %; "
                "expected readings of all outputs at the same samples; test outputs that are read at other times, or never, on their own"
            )


def _columns(where: str, what: str, array: Array, names: Sequence[str], n: int) -> None:
    if array.shape != (n, len(names)):
        raise BadInput(f"{where}: {what} has shape {array.shape}; expected {(n, len(names))}, one column for each of {list(names)}")
    wrong = np.isinf(array) if what == "residual" else ~np.isfinite(array)
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        raise BadInput(f"{where}: {what} '{names[column]}' is {array[row, column]} at sample {row}; expected finite numbers")


@dataclass(frozen=True, slots=True, eq=False)
class Centred:
    """Residuals less their mean in each recording, of unit rms over all recordings.

    ``scale (p,)`` is that rms, ``offset (p,)`` the share of the whole power in the means: a constant is an offset (sensor, load),
    no gap that the inputs explain, and is reported beside the test.
    """

    pieces: list[Array]
    scale: Array
    offset: Array


def centred(recordings: Sequence[ResidualSignals]) -> Centred:
    """Return the centred residuals; an output whose residual is constant keeps a scale of 1."""
    largest = np.nanmax(np.abs(np.vstack([r.residual for r in recordings])), axis=0)
    unit = np.where(largest > 0, largest, 1.0)  # squares of a diverging simulation overflow
    means = [_mean(r.residual / unit) for r in recordings]
    E = [r.residual / unit - m for r, m in zip(recordings, means, strict=True)]
    counts = np.array([np.isfinite(e).sum(0) for e in E])
    total = np.maximum(counts.sum(0), 1)
    power = np.sum([np.nansum(e**2, 0) for e in E], axis=0) / total
    offset = (counts * np.array(means) ** 2).sum(0) / total
    scale = np.sqrt(np.where(power > 0, power, 1.0))
    whole = power + offset
    return Centred([e / scale for e in E], scale * unit, np.where(whole > 0, offset / np.where(whole > 0, whole, 1.0), 0.0))


def _mean(x: Array) -> Array:
    """Return the mean of each column over its finite samples; zero where there are none."""
    known = np.isfinite(x)
    return np.asarray(np.where(known, x, 0.0).sum(0) / np.maximum(known.sum(0), 1))
