"""Recordings that must not be fitted, each named: gaps, frozen samples, saturation, drift, too few samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from afdsvc.api.signals import Trace, of_role
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array

#: Share of samples at an end stop above which an input counts as saturated.
SATURATED_SHARE = 0.005
#: Share of an output's power that a straight line may explain.
DRIFT_SHARE = 0.1
STRETCHES = 10  # whose means show a trend
#: Consecutive samples in which nothing at all changes, above which the recorder must have stood still.
FROZEN_SAMPLES = 8
LEAST, LARGEST = 1e-60, 1e60  # of the largest value of a channel


def require_sizes(trace: Trace) -> None:
    """Raise `BadInput` for a channel whose values are too large or too small to be squared and cubed."""
    for channel, column in zip(trace.channels, np.abs(trace.values).T, strict=True):
        largest = float(np.max(column, where=np.isfinite(column), initial=0.0))
        if largest and not LEAST < largest < LARGEST:
            raise BadInput(f"{trace.name}: {channel.name} has values of up to {largest:.3g}; expected sizes between {LEAST:g} and {LARGEST:g}, in a suitable unit")


def screen(trace: Trace, needed: int) -> None:
    """Raise `BadInput` naming recording, channel and cure when the trace cannot be fitted or has
    fewer than ``needed`` samples.

    Looks at the roles u, y and alpha.
    """
    if len(trace) < needed:
        raise BadInput(
            f"{trace.name}: {len(trace)} samples ({len(trace) * trace.dt:.3g} s) are too short; "
            f"expected at least {needed} ({needed * trace.dt:.3g} s) for this order and horizon"
        )
    columns = of_role(trace.channels, "u") + of_role(trace.channels, "y") + of_role(trace.channels, "alpha")
    _gaps(trace, columns)
    for sentence in screening_notes(trace):
        raise BadInput(sentence)


def screening_notes(trace: Trace) -> list[str]:
    """Return what speaks against fitting a trace without missing samples, a sentence each: frozen samples, saturation, drift."""
    u, y = of_role(trace.channels, "u"), of_role(trace.channels, "y")
    found = [_frozen(trace, u + y), *(_saturation(trace, c) for c in u), *(_drift(trace, c) for c in y)]
    return [sentence for sentence in found if sentence]


def without_gaps(trace: Trace) -> list[Trace]:
    """Return the stretches of a trace in which no sample of u or y is missing, the trace itself where there is no gap."""
    columns = of_role(trace.channels, "u") + of_role(trace.channels, "y")
    whole = np.isfinite(trace.values[:, columns]).all(axis=1)
    if whole.all():
        return [trace]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], whole.astype(int), [0]])))
    return [trace.span(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _gaps(trace: Trace, columns: Sequence[int]) -> None:
    for column in columns:
        missing = np.flatnonzero(~np.isfinite(trace.values[:, column]))
        if missing.size:
            raise BadInput(
                f"{trace.name}: {missing.size} samples of '{trace.channels[column].name}' are missing, the first at "
                f"{trace.t[missing[0]]:.6g} s; cut the recording into pieces without gaps"
            )


def _frozen(trace: Trace, columns: Sequence[int]) -> str:
    values = trace.values[:, columns]
    if not len(columns) or not np.ptp(values, axis=0).any():
        return ""
    still = (np.diff(values, axis=0) == 0).all(axis=1)
    start, length = _longest_run(still)
    if length >= FROZEN_SAMPLES and not _commanded_steps(values):
        return (
            f"{trace.name}: every signal stands still for {length} samples from {trace.t[start]:.6g} s on, so "
            "samples were lost "
            "(a gap) or the recorder froze; cut the recording there"
        )
    return ""


def _commanded_steps(values: Array) -> bool:
    """Whether standing still is how these signals are: most samples equal their predecessor (coarsely quantised)."""
    return bool((np.diff(values, axis=0) == 0).all(axis=1).mean() > 0.5)


def _saturation(trace: Trace, column: int) -> str:
    u: Array = trace.values[:, column]
    levels = np.unique(u)
    if levels.size <= 5:  # a switched input lives at its ends
        return ""
    for level, side in ((levels[-1], "highest"), (levels[0], "lowest")):
        at = u == level
        # Digital amplitudes repeat too, but the level next to an end stop is then about as frequent as the stop itself.
        neighbour = int(np.count_nonzero(u == (levels[-2] if side == "highest" else levels[1])))
        count = int(np.count_nonzero(at))
        if count > max(SATURATED_SHARE * len(u), 5.0 * neighbour, 5.0):
            name = trace.channels[column]
            return (
                f"{trace.name}: '{name.name}' sits at its {side} value {level:.6g} {name.unit} in "
                f"{100 * count / len(u):.3g} % of the "
                f"samples (longest {_longest_run(at)[1]} in a row): the actuator saturates; excite with a "
                "smaller amplitude"
            )
    return ""


def _drift(trace: Trace, column: int) -> str:
    y, t = trace.values[:, column], np.linspace(-1, 1, len(trace))
    y = y - y.mean()
    power = float(y @ y)
    if len(y) < STRETCHES or not power > 0:
        return ""
    slope = float(t @ y) / float(t @ t)
    share = slope**2 * float(t @ t) / power
    if share > DRIFT_SHARE and _trend_p_value(y, slope * t) < 1e-3:
        name = trace.channels[column]
        return (
            f"{trace.name}: '{name.name}' drifts by {2 * slope:.3g} {name.unit} over the recording "
            f"({100 * share:.3g} % of its power, expected at most {100 * DRIFT_SHARE:.3g} %); "
            "wait until the machine is warm, or remove the trend first"
        )
    return ""


def _trend_p_value(y: Array, line: Array) -> float:
    """Return how likely the means of the stretches rise like this without a trend (rank correlation, immune to colour)."""
    means = np.asarray([part.mean() for part in np.array_split(y, STRETCHES)])
    return float(stats.kendalltau(np.arange(STRETCHES), means * np.sign(line[-1]), alternative="greater").pvalue)


def _longest_run(flags: Array) -> tuple[int, int]:
    """Return start and length of the longest run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    starts, stops = edges[::2], edges[1::2]
    if not starts.size:
        return 0, 0
    longest = int(np.argmax(stops - starts))
    return int(starts[longest]), int(stops[longest] - starts[longest])
