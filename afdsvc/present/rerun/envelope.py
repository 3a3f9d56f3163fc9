"""Envelope of a signal with fewer points: the extremes of every few samples, at their own times."""

from __future__ import annotations

import numpy as np

from afdsvc.lti.statespace import Array


def envelope(values: Array, width: int) -> tuple[np.ndarray, Array]:
    """Return sample numbers ``(k,)`` and values ``(k, channels)`` of two points per ``width`` samples.

    Each bin keeps its smallest and its largest value per channel, in the order they came; the points stand at its first
    and its middle sample. NaN is passed over unless a whole bin is NaN. Bins of two samples or less are kept.
    """
    n, channels = values.shape
    if width <= 2:
        return np.arange(n), values
    full = n // width
    bins = values[: full * width].reshape(full, width, channels)
    low, high = np.fmin.reduce(bins, axis=1), np.fmax.reduce(bins, axis=1)
    rising = _first_place(bins, low) <= _first_place(bins, high)
    pairs = np.where(rising[:, None, :], np.stack([low, high], axis=1), np.stack([high, low], axis=1))
    starts = np.arange(full) * width
    places = np.stack([starts, starts + width // 2], axis=1).reshape(-1)
    rest = np.arange(full * width, n)
    return np.concatenate([places, rest]), np.concatenate([pairs.reshape(-1, channels), values[full * width :]])


def _first_place(bins: Array, value: Array) -> np.ndarray:
    return np.asarray(np.argmax(bins == value[:, None, :], axis=1))
