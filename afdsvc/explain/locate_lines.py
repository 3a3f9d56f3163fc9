"""The part of every output's residual that repeats with the excitation: how much, at which kind of lines, how surely.

Each line is weighed by the scatter between periods around it, so coloured noise needs no model. What does not repeat but
stands out (tones, drift, rotation) has to be taken out before: it would leak into both sides of the test.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from afdsvc.dataset.experiment import Run
from afdsvc.dataset.periods import fold, running_median
from afdsvc.lti.statespace import Array
from afdsvc.stats.periodic import EXCITED

BoolArray = NDArray[np.bool_]
WINDOW = 41  # lines over which the scatter is smoothed
CLEAR = 7.0  # power of a line over its noise from which it is clearly no noise (one in a thousand)
ALONE, ALIKE = 5.0, 1.15  # amplitude of a lonely line over its neighbours' median; ratio between levels that counts as equal


@dataclass(frozen=True, slots=True)
class Part:
    """A kind of line in one output: power above noise (mean square, output's unit squared), F, its p-value, lines."""

    power: float
    f: float
    p: float
    lines: int


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """What repeats in one output: everything up to the edge, and by kind (excited, odd, even, above the band).

    ``band`` [rad/s] holds all but a tenth of the repeating power; ``per_run`` lists the rms that repeats and its standard error of every run, in order (zeros where nothing can repeat).
    """

    total: Part
    kinds: dict[str, Part]
    band: tuple[float, float]
    per_run: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Spectrum:
    """One run: mean-square power of the repeating part and of its noise per line ``(lines, p)``, masks, line spacing, periods."""

    mean: Array
    noise: Array
    kinds: dict[str, BoolArray]
    step: float
    periods: int
    weight: float


def splits(runs: Sequence[Run], residuals: Sequence[Array], top: float) -> list[Split]:
    """Return one split per output, up to the angular frequency ``top`` [rad/s]; none when no excitation repeats."""
    total = sum(len(r) for r in runs)
    each = [_spectrum(run, e, top, total) for run, e in zip(runs, residuals, strict=True)]
    found = [s for s in each if s is not None]
    if not found:
        return []
    return [_split(found, [_size(s, j) for s in each], j) for j in range(found[0].mean.shape[1])]


def _size(s: _Spectrum | None, j: int) -> tuple[float, float]:
    """Return the rms of what repeats and its standard error."""
    if s is None:
        return 0.0, 0.0
    mean, noise = s.mean[:, j], s.noise[:, j]
    power = float((mean - noise).sum())
    spread = float(np.sqrt((noise**2 + 2 * noise * np.maximum(mean - noise, 0)).sum()))
    rms = float(np.sqrt(max(power, 0.0)))
    return rms, spread / (2 * rms) if rms > 0 else 0.0


def _spectrum(run: Run, e: Array, top: float, total: int) -> _Spectrum | None:
    folded, drive = fold(run, e), fold(run, run.U)
    if folded is None or drive is None:
        return None
    count, n = folded.shape[0], folded.shape[1]
    spectrum = np.fft.rfft(folded, axis=1) * np.sqrt(2) / n
    mean = spectrum.mean(0)
    scatter = (np.abs(spectrum - mean) ** 2).sum(0) / (count - 1)
    step = 2 * np.pi / (n * run.dt)
    last = int(np.clip(1.5 * top / step, 4, n // 2 - 1))
    rows = slice(1, last + 1)
    noise = _noise(scatter[rows], count - 1) / count
    kinds = _kinds(drive.mean(0), last, top / step)
    return _Spectrum(np.abs(mean[rows]) ** 2, noise, kinds, step, count, len(run) / total)


def _noise(scatter: Array, freedom: int) -> Array:
    """Return the scatter smoothed over neighbouring lines: their median, freed of the median's bias, which tones cannot lift."""
    bias = float(stats.chi2.ppf(0.5, 2 * freedom) / (2 * freedom))
    return np.maximum(running_median(scatter, WINDOW) / bias, 1e-300)


def _kinds(drive: Array, last: int, top: float) -> dict[str, BoolArray]:
    size = np.abs(np.fft.rfft(drive, axis=0))[1 : last + 1].max(1)
    orders = np.arange(1, last + 1)
    excited = size > EXCITED * size.max(initial=0.0)
    only_odd = not (excited & (orders % 2 == 0)).any()
    inside, odd = orders <= top, orders % 2 == 1
    return {
        "excited": excited,
        "odd": ~excited & odd & inside & only_odd,
        "even": ~excited & ~odd & inside & only_odd,
        "above the band": ~excited & ~inside,
    }


def _split(found: Sequence[_Spectrum], per_run: Sequence[tuple[float, float]], j: int) -> Split:
    everything = [np.ones(len(s.mean), bool) for s in found]
    kinds = {}
    for kind in found[0].kinds:
        masks = [s.kinds[kind] for s in found]
        if any(m.any() for m in masks):
            kinds[kind] = _part(found, masks, j)
    return Split(_part(found, everything, j), kinds, _band(found, j), tuple(per_run))


def _part(found: Sequence[_Spectrum], masks: Sequence[BoolArray], j: int) -> Part:
    """Add up lines in units of their noise: under noise alone a line is chi-square of two degrees, so their mean is F."""
    ratios = np.concatenate([(s.mean[m, j] / s.noise[m, j]) for s, m in zip(found, masks, strict=True)])
    lines = ratios.size
    if lines == 0:
        return Part(0.0, 0.0, 1.0, 0)
    # The running median of a window has about two thirds of the window's degrees of freedom.
    freedom = max(2 * lines * (found[0].periods - 1) * 0.6, 4.0)
    f = float(ratios.mean())
    power = sum(s.weight * float((s.mean[m, j] - s.noise[m, j]).sum()) for s, m in zip(found, masks, strict=True))
    return Part(power, f, float(stats.f.sf(f, 2 * lines, freedom)), lines)


def _band(found: Sequence[_Spectrum], j: int) -> tuple[float, float]:
    """Return the angular frequencies between which all but a twentieth on either side of the power above noise lies."""
    s = max(found, key=lambda s: float((s.mean[:, j] - s.noise[:, j]).sum() * s.weight))
    excess = np.where(s.mean[:, j] > CLEAR * s.noise[:, j], s.mean[:, j], 0.0)
    if not excess.any():
        excess = np.maximum(s.mean[:, j] - s.noise[:, j], 0.0)
    share = np.cumsum(excess)
    if not share[-1] > 0:
        return s.step, len(s.mean) * s.step
    low, high = np.searchsorted(share, [0.05 * share[-1], 0.95 * share[-1]])
    return float((low + 1) * s.step), float((high + 1) * s.step)


def steady(runs: Sequence[Run], residuals: Sequence[Array]) -> list[tuple[float, int]]:
    """Return lines that repeat with the excitation's period but do not answer to it: angular frequency [rad/s] and output.

    Such a line stands alone among its neighbours and is equally tall at every level of the excitation. A mains tone that
    fits the period is one.
    """
    each = [s for run, e in zip(runs, residuals, strict=True) if (s := _spectrum(run, e, np.pi / run.dt / 2, 1)) is not None]
    levels = [float(np.std(run.W if run.W is not None else run.U)) for run in runs if run.period]
    same_lines = {len(s.mean) for s in each}
    if len(each) < 2 or len(same_lines) > 1 or max(levels) < 1.2 * min(levels):
        return []
    found = []
    for j in range(each[0].mean.shape[1]):
        size = np.sqrt(np.stack([s.mean[:, j] for s in each]))
        tall = np.stack([size[i] > ALONE * running_median(size[i][:, None], WINDOW)[:, 0] for i in range(len(each))]).all(0)
        alike = size.max(0) < ALIKE * size.min(0)
        found += [(float((k + 1) * each[0].step), j) for k in np.flatnonzero(tall & alike)]
    return found
