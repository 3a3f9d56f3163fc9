"""Peaks of the residual's spectrum: candidates for resonances missing in the model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from afdsvc.dataset.experiment import Run
from afdsvc.dataset.periods import fold, running_median
from afdsvc.lti.statespace import Array

LONGEST = 8192  # samples of one spectrum
RELATIVE = 0.02  # half the width of a resonance, as a part of its frequency
NEIGHBOURHOOD = 305  # bins whose median is the level of noise
MOST = 5, 2  # peaks in all, and the largest among them
APART = 0.1  # of a frequency, below which two peaks are one


def peaks(runs: Sequence[Run], residuals: Sequence[Array], below: float = np.inf) -> list[float]:
    """Return angular frequencies [rad/s] at which the spectrum of the residual stands out, up to ``below``.

    First those that tower over their neighbourhood, as a faint resonance in white noise does, in turn in the whole residual and
    in what of it repeats; then the largest that there are.
    """
    clean = [np.nan_to_num(e) for e in residuals]
    whole, bin_ = _power(runs, clean)
    smooth = np.convolve(whole, np.ones(5) / 5, "same")
    level = running_median(smooth[:, None], NEIGHBOURHOOD)[:, 0]
    standing = [_ranked(_excess(whole / np.maximum(level, 1e-300)), bin_, below)]
    in_step = _repeating(runs, clean)
    if in_step is not None:
        standing.append(_ranked(_excess(in_step[0]), in_step[1], below))
    largest = _ranked(smooth * np.sqrt(np.arange(len(smooth))), bin_, below)
    chosen: list[float] = []
    _fill(chosen, _in_turn(standing), MOST[0] - MOST[1] if in_step is not None else MOST[1])
    _fill(chosen, iter(largest), len(chosen) + MOST[1])
    return chosen


def _power(runs: Sequence[Run], residuals: Sequence[Array]) -> tuple[Array, float]:
    """Return the power per bin over all runs and outputs, each in units of its spread, and the width of a bin [rad/s]."""
    n = min(min(len(e) for e in residuals), LONGEST)
    power: Array = np.zeros(n // 2 + 1)
    for e in residuals:
        scale = np.maximum(e.std(0), 1e-300)
        for start in range(0, len(e) - n + 1, n):
            power += (np.abs(np.fft.rfft((e[start : start + n] / scale) * np.hanning(n)[:, None], axis=0)) ** 2).sum(1)
    return power, 2 * np.pi / (n * runs[0].dt)


def _repeating(runs: Sequence[Run], residuals: Sequence[Array]) -> tuple[Array, float] | None:
    """Return the power of what repeats, at the lines of the period, over what noise leaves there (1), and their distance [rad/s].

    Over all runs of the first one's period; None where nothing repeats.
    """
    period = runs[0].period
    folded = [f for r, e in zip(runs, residuals, strict=True) if r.period == period and (f := fold(r, e)) is not None]
    if not folded:
        return None
    ratios = []
    for periods in folded:
        spectrum = np.fft.rfft(periods, axis=1)
        mean = spectrum.mean(0)
        scatter = (np.abs(spectrum - mean) ** 2).sum(0) / (len(periods) - 1)
        ratios.append(len(periods) * np.abs(mean) ** 2 / np.maximum(running_median(scatter, NEIGHBOURHOOD), 1e-300))
    return np.mean(ratios, axis=(0, 2)), 2 * np.pi / (period * runs[0].dt)


def _excess(power: Array) -> Array:
    """Return by how many standard errors the power around every bin, over a part of its frequency, is above one."""
    k = np.arange(len(power))
    half = np.maximum(2, np.round(RELATIVE * k)).astype(np.int64)
    first, last = np.maximum(k - half, 0), np.minimum(k + half + 1, len(power))
    sums = np.concatenate([[0.0], np.cumsum(power - 1)])
    return np.asarray((sums[last] - sums[first]) / np.sqrt(last - first))


def _ranked(size: Array, bin_: float, below: float) -> list[float]:
    """Return the frequencies of the local maxima up to ``below``, the largest first."""
    inner: NDArray[np.int64] = np.arange(3, int(min(len(size) - 1, max(below / bin_, 4))))
    tops = inner[(size[inner] >= size[inner - 1]) & (size[inner] > size[inner + 1])]
    return [float(bin_ * k) for k in sorted(tops, key=lambda k: -size[k])[: 8 * MOST[0]]]


def _in_turn(lists: Sequence[Sequence[float]]) -> Iterator[float]:
    for several in zip(*lists, strict=False):
        yield from several


def _fill(chosen: list[float], offered: Iterator[float], count: int) -> None:
    """Add what is offered until there are so many, but nothing beside what is there."""
    for omega in offered:
        if len(chosen) >= count:
            return
        if all(abs(omega - c) > APART * c for c in chosen):
            chosen.append(omega)
