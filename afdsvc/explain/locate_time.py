"""Spans of time in which a residual is louder than in the rest of the recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from afdsvc.dataset.experiment import Run
from afdsvc.dataset.periods import fold
from afdsvc.lti.statespace import Array
from afdsvc.stats.ar_noise import correlation_time

BLOCKS = 40
SURE = 1e-6


@dataclass(frozen=True, slots=True)
class Span:
    """A span of one recording [s from its start], how many times its power is that of the rest (``usual``, mean square), and
    the p-value."""

    run: str
    start: float
    stop: float
    ratio: float
    p: float
    usual: float


def loud_span(runs: Sequence[Run], residuals: Sequence[Array], j: int) -> Span | None:
    """Return the loudest span of output ``j`` when some blocks of a recording are louder than its others; None otherwise.

    What repeats with the excitation is taken out first: a multisine has loud moments of its own.
    """
    found = [s for run, e in zip(runs, residuals, strict=True) if (s := _of_run(run, e[:, j])) is not None]
    return min(found, key=lambda s: s.p, default=None)


def _of_run(run: Run, e: Array) -> Span | None:
    x, start = _wandering(run, e)
    length = len(x) // BLOCKS
    if length < 16:
        return None
    blocks = (x[: length * BLOCKS].reshape(BLOCKS, length) ** 2).mean(1)
    usual = float(np.median(blocks))
    if usual <= 0:
        return None
    worth = length / max(correlation_time(x[:, None]), 1.0)
    p = np.minimum(stats.f.sf(blocks / usual, worth, worth * BLOCKS / 2) * BLOCKS, 1.0)
    loud = np.flatnonzero(p < SURE)
    if not loud.size or loud.size > BLOCKS // 2:
        return None
    peak = int(np.argmax(blocks))
    first, last = _around(set(loud.tolist()), peak)
    seconds = length * run.dt
    begin = start * run.dt
    ratio = float(blocks[first : last + 1].mean() / usual)
    return Span(run.name, begin + first * seconds, begin + (last + 1) * seconds, ratio, float(p[peak]), usual)


def _around(loud: set[int], peak: int) -> tuple[int, int]:
    first = last = peak
    while first - 1 in loud:
        first -= 1
    while last + 1 in loud:
        last += 1
    return first, last


def _wandering(run: Run, e: Array) -> tuple[Array, int]:
    """Return what does not repeat and the sample it begins at."""
    folded = fold(run, e[:, None])
    if folded is None or len(folded) < 3:
        return e - e.mean(), 0
    apart = (folded - folded.mean(0)).ravel()
    return apart, len(e) - apart.size
