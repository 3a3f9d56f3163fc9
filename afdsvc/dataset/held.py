"""Held readings: a sensor that is read less often than samples are recorded, each reading repeated until the next one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from afdsvc.lti.statespace import Array

READINGS = 20  # changes from which on their distances are compared
LEVELS = 10  # different values of a signal that is more than switched
REGULAR = 0.95  # share of the distances between changes that are multiples of one distance: two clocks may slip now and then


def interval(y: Array) -> int:
    """Return the samples from one reading ``y (n,)`` to the next, 1 where every sample may be one."""
    changes = _changes(y)
    if len(changes) < READINGS or len(np.unique(y)) < LEVELS or not np.isfinite(y).all():
        return 1
    gaps = np.diff(changes)
    return next((k for k in range(int(np.quantile(gaps, 1 - REGULAR)), 1, -1) if (gaps % k == 0).mean() >= REGULAR), 1)


def taken(y: Array, every: int) -> NDArray[np.intp]:
    """Return the sample at which each reading of a signal ``(n,)`` was taken; the first ones, of before the recording, count as taken with it."""
    changes, at = _changes(y), np.arange(len(y))
    last = np.concatenate([changes[:1], changes])[np.searchsorted(changes, at, "right")] if len(changes) else np.zeros(len(y), int)
    return np.asarray(np.maximum(at - (at - last) % every, 0), dtype=np.intp)


def _changes(y: Array) -> NDArray[np.intp]:
    return np.flatnonzero(np.diff(y) != 0) + 1
