"""Samples at another rate: one low-pass kernel for every column, so that what relates them is not changed below its cut-off.

The kernel is a sinc under a Kaiser window: flat (to 1e-4) up to `FLAT` of the lower of all rates involved, down by 80 dB from half of it
on. It has no delay. A column sampled with a period T contributes ``sum_k x_k h(t - k T)`` with weights that sum to one, which is a
low-pass filter and an interpolation at once and needs no common multiple of the rates. Where the kernel has not all its neighbours
there is no value.
"""

from __future__ import annotations

import numpy as np

from afdsvc.lti.statespace import Array

FLAT, STOP = 0.4, 0.5  # of the lower rate
ATTENUATION = 80.0  # dB
BETA = 0.1102 * (ATTENUATION - 8.7)  # of the Kaiser window, by Kaiser's own formula
HALF = (ATTENUATION - 7.95) / (2 * 2.285 * 2 * np.pi * (STOP - FLAT))  # half the kernel's length, in periods of the lower rate
_AT_ONCE = 1 << 22  # weights held in memory


def reach(period: float) -> float:
    """Return how far [s] the kernel for a slowest period [s] looks to either side."""
    return HALF * period


def resampled(values: Array, start: float, step: float, times: Array, period: float) -> Array:
    """Return columns ``(n, c)`` sampled at ``start + k step`` at other times ``(q,)``, low-passed for the slowest ``period``.

    Every time must lie `reach` inside the samples; all in seconds.
    """
    if not len(times):
        return np.zeros((0, values.shape[1]))
    width = int(np.ceil(reach(period) / step))
    around = np.arange(-width, width + 2)
    out = np.empty((len(times), values.shape[1]))
    chunk = max(1, _AT_ONCE // len(around))
    for a in range(0, len(times), chunk):
        place = (times[a : a + chunk] - start) / step
        first = np.floor(place).astype(np.int64)
        weights = _kernel((place - first)[:, None] - around[None, :], step / period)
        weights /= weights.sum(axis=1, keepdims=True)
        rows = np.clip(first[:, None] + around[None, :], 0, len(values) - 1)  # those outside have weight 0
        out[a : a + chunk] = np.einsum("qk,qkc->qc", weights, values[rows])
    return out


def _kernel(offset: Array, ratio: float) -> Array:
    """Return the kernel at offsets in samples; ``ratio`` is the samples' period over the slowest one."""
    cut = (FLAT + STOP) * ratio  # twice the cut-off, in cycles per sample
    inside = np.clip(1 - np.square(offset * ratio / HALF), 0.0, None)
    return np.asarray(np.sinc(cut * offset) * np.where(inside > 0, np.i0(BETA * np.sqrt(inside)), 0.0))
