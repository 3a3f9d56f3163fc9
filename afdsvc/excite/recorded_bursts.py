"""Bursts found again in recorded excitation: where alpha is not zero, and which lines it is made of."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.signals import Block
from afdsvc.lti.statespace import Array

EXACT = 1e-4  # largest deviation from a sum of sines, as a share of the peak: tables hold rounded numbers
LINES = 12  # most lines on one input
REFINED = 12  # Gauss-Newton steps of the frequencies


def recorded_bursts(alpha: Array, dt: float, apart: int, settle: int) -> list[tuple[int, Burst]]:
    """Return first sample and burst of every stretch of ``alpha (n, m)`` that is not zero.

    Stretches fewer than ``apart`` samples from each other are one burst: the loop has not settled between them. A burst that is a
    sum of sines between raised-cosine ramps comes back as such, ``settle`` samples after the ramp being left out of the analysis of
    its lines; any other as a waveform.
    """
    played = np.flatnonzero(np.any(alpha != 0, axis=1))
    if not len(played):
        return []
    cuts = np.flatnonzero(np.diff(played) > max(apart, 1))
    first, last = played[np.r_[0, cuts + 1]], played[np.r_[cuts, len(played) - 1]]
    edges = [(max(a - 1, 0), min(b + 2, len(alpha))) for a, b in zip(first.tolist(), last.tolist(), strict=True)]  # ramps begin and end at 0
    return [(a, _burst(f"burst {k + 1}", alpha[a:b], dt, settle)) for k, (a, b) in enumerate(edges)]


def marked(blocks: Iterable[Block], bursts: Sequence[tuple[int, Burst]]) -> Iterator[Block]:
    """Yield blocks with the names of the bursts in them, cut where a burst begins or ends; ``bursts`` with their first samples."""
    for block in blocks:
        end = block.k0 + len(block)
        edges = {e for first, burst in bursts for e in (first, first + burst.samples) if block.k0 < e < end}
        for a, b in pairwise(sorted({block.k0, end, *edges})):
            name = next((burst.name for first, burst in bursts if first <= a < first + burst.samples), block.burst)
            stamp = block.t0_ns + round((a - block.k0) * block.dt * 1e9)
            yield replace(block, k0=a, t0_ns=stamp, values=block.values[a - block.k0 : b - block.k0], burst=name)


def _burst(name: str, alpha: Array, dt: float, settle: int) -> Burst:
    n, m = alpha.shape
    lines = tuple(line for i in range(m) for line in _lines(alpha[:, i], i, dt, 0.1 * EXACT * float(np.abs(alpha).max())))

    def with_ramp(ramp: int) -> tuple[float, Burst]:
        found = Burst(name, m, n, ramp, lines, settle=settle)
        return float(np.abs(found.play(dt) - alpha).max()), found

    low, high = 0, n // 2
    while high - low > 2:  # the deviation has one minimum
        third = (high - low) // 3
        low, high = (low, high - third) if with_ramp(low + third)[0] < with_ramp(high - third)[0] else (low + third, high)
    error, found = min((with_ramp(ramp) for ramp in range(low, high + 1)), key=lambda pair: pair[0])
    return found if error <= EXACT * np.abs(alpha).max() else Burst(name, m, n, 0, waveform=alpha.copy())


def _lines(alpha: Array, number: int, dt: float, tolerance: float) -> list[Line]:
    """Return the sines of the middle third of one input, the largest first, until nothing above the tolerance is left."""
    n = len(alpha)
    x: Array = alpha[n // 3 : n - n // 3]
    t: Array = dt * np.arange(n // 3, n - n // 3, dtype=np.float64)
    omega, amplitude, left = np.zeros(0), np.zeros((0, 2)), x
    while np.abs(left).max(initial=0.0) > tolerance and len(omega) < min(LINES, len(x) // 8):
        bins = 8 * len(x)
        spectrum = np.abs(np.fft.rfft(left * np.hanning(len(left)), bins))
        omega = _refined(np.append(omega, 2 * math.pi * int(np.argmax(spectrum)) / (bins * dt)), x, t)
        amplitude = np.array(np.linalg.lstsq(_waves(omega, t), x, rcond=None)[0].reshape(2, -1).T, dtype=np.float64)
        left = np.asarray(x - _waves(omega, t) @ amplitude.T.ravel())
    found = zip(omega.tolist(), amplitude.tolist(), strict=True)
    return [Line(number, w, math.hypot(s, c), math.atan2(c, s)) for w, (s, c) in found]


def _refined(omega: Array, x: Array, t: Array) -> Array:
    """Return the frequencies after Gauss-Newton steps on frequencies and amplitudes together."""
    middle = float(t.mean())
    for _ in range(REFINED):
        waves = _waves(omega, t - middle)
        s, c = np.linalg.lstsq(waves, x, rcond=None)[0].reshape(2, -1)
        slope = (t - middle)[:, None] * (waves[:, : len(omega)] * -c + waves[:, len(omega) :] * s)
        omega = np.asarray(omega + np.linalg.lstsq(np.hstack([waves, slope]), x, rcond=None)[0][2 * len(omega) :])
    return omega


def _waves(omega: Array, t: Array) -> Array:
    return np.hstack([np.sin(np.outer(t, omega)), np.cos(np.outer(t, omega))])
