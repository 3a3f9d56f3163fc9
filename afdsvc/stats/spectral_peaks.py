"""Peaks of the residual's spectrum: candidates for resonances missing in the model.

The part of a residual that is periodic with the excitation: its size, the kind of lines, and its significance.

Noise does not repeat, so what repeats is the model's doing. Excited lines hold linear errors (and odd distortion), lines
left out of an odd excitation show odd and even distortion apart.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

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


EXCITED = 0.02  # amplitude of a line over the largest from which it counts as excited
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Share:
    """Power of a kind of line: ``power`` above noise (in units of the noise's power per number), its sd, F-test p-value."""

    power: float
    sd: float
    p: float
    lines: int


@dataclass(frozen=True, slots=True, eq=False)
class Repeating:
    """What repeats, in whitened units summed over runs: everything, and by kind of line; ``numbers`` counts the data."""

    total: Share
    kinds: dict[str, Share]
    per_output: tuple[Share, ...]
    numbers: int


def repeating(runs: Sequence[Run], whitened: Sequence[Array], top: float) -> Repeating | None:
    """Return the repeating part up to the angular frequency ``top`` [rad/s]; None when no excitation repeats."""
    parts = [p for run, w in zip(runs, whitened, strict=True) if (p := _lines(run, w, top)) is not None]
    if not parts:
        return None
    kinds = {}
    for kind in ("excited", "odd", "even"):
        chosen = [(s[m[kind]], n[m[kind]], d) for s, n, m, d in parts]
        if sum(c[0].size for c in chosen):
            kinds[kind] = _share(chosen)
    everything = [(s, n, d) for s, n, _, d in parts]
    outputs = parts[0][0].shape[1]
    each = tuple(_share([(s[:, [j]], n[:, [j]], d) for s, n, _, d in parts]) for j in range(outputs))
    return Repeating(_share(everything), kinds, each, sum(s.size for s, _, _, _ in parts))


def _lines(run: Run, w: Array, top: float) -> tuple[Array, Array, dict[str, BoolArray], int] | None:
    """Return per line and output the power of the mean (times periods), of the scatter, the masks of kinds, and periods - 1."""
    folded, drive = fold(run, w), fold(run, run.U)
    if folded is None or drive is None:
        return None
    count, n = folded.shape[0], folded.shape[1]
    spectrum = np.fft.rfft(folded, axis=1) / np.sqrt(n)
    mean = spectrum.mean(0)
    scatter = (np.abs(spectrum - mean) ** 2).sum(0) / (count - 1)
    last = int(np.clip(top * n * run.dt / (2 * np.pi), 4, n // 2 - 1))
    rows = slice(1, last + 1)
    return count * np.abs(mean[rows]) ** 2, scatter[rows], _kinds(drive.mean(0), last), count - 1


def _kinds(drive: Array, last: int) -> dict[str, BoolArray]:
    size = np.abs(np.fft.rfft(drive, axis=0))[1 : last + 1].max(1, initial=0.0)
    orders = np.arange(1, last + 1)
    excited = size > EXCITED * size.max(initial=0.0)
    odd = orders % 2 == 1
    only_odd = not (excited & ~odd).any()
    return {"excited": excited, "odd": ~excited & odd & only_odd, "even": ~excited & ~odd & only_odd}


def _share(parts: Sequence[tuple[Array, Array, int]]) -> Share:
    """Add up lines: each is two real numbers, so its mean power is F distributed against its scatter."""
    lines = sum(s.size for s, _, _ in parts)
    power = 2 * sum(float(s.sum()) for s, _, _ in parts)
    noise = 2 * sum(float(n.sum()) for _, n, _ in parts)
    freedom = 2 * sum(s.size * d for s, _, d in parts)
    if lines == 0 or noise <= 0:
        return Share(0.0, 0.0, 1.0, lines)
    sd = float(np.sqrt(4 * lines + 4 * lines**2 * 2 / max(freedom, 1)))
    p = float(stats.f.sf(power / noise, 2 * lines, freedom))
    return Share(power - noise, sd * noise / (2 * lines), p, lines)
