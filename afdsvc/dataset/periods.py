"""Settled periods of a residual, what differs between them, and the running median over neighbouring lines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.lti.statespace import Array

FEW = 0.01  # largest share of missing samples for which periods are estimated from the others


def fold(run: Run, e: Array) -> Array | None:
    """Return the settled periods of a residual, shape ``(periods, period, p)``; None when there are fewer than two.

    A few missing samples are the mean of the others of their phase; with more than `FEW` of them, the answer is None.
    """
    if not run.period:
        return None
    start = max(run.settled, run.period // 4)
    count = (len(e) - start) // run.period
    if count < 2:
        start, count = len(e) - 2 * run.period, 2
        if start < run.settled:
            return None
    folded = e[len(e) - count * run.period :].reshape(count, run.period, -1)
    return _bridged(folded)


def _bridged(folded: Array) -> Array | None:
    missing = np.isnan(folded)
    if np.isinf(folded).any() or missing.mean() > FEW or missing.all(0).any():
        return None
    return np.where(missing, np.nanmean(folded, axis=0), folded) if missing.any() else folded


def wandering(runs: Sequence[Run], residuals: Sequence[Array]) -> list[Array]:
    """Return the part of each period that does not repeat, ``(period, p)`` each, scaled to the variance of the noise.

    Empty when no run holds two settled periods without gaps.
    """
    folded = [f for run, e in zip(runs, residuals, strict=True) if (f := fold(run, e)) is not None]
    return [x for f in folded for x in (f - f.mean(0)) * np.sqrt(len(f) / (len(f) - 1))]


def running_median(size: Array, width: int) -> Array:
    """Return the median of the neighbourhood of each row, per column."""
    half = min(width, max(len(size) // 2 * 2 - 1, 1)) // 2
    padded = np.pad(size, ((half, half), (0, 0)), mode="reflect")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0), axis=-1)
