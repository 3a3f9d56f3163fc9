"""Tones: spectral lines of the residual that do not come from the excitation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from afdsvc.dataset.experiment import Run
from afdsvc.dataset.periods import fold, running_median
from afdsvc.lti.statespace import Array

TALL = 7.0  # how far a tone towers over the median of its neighbourhood (amplitude)
HEARD = 5.5  # the same for one that comes from outside, in all runs together: noise alone gets there in one machine of hundreds
NEIGHBOURHOOD = 61
ALONE = 3.0  # times the neighbouring lines of the excitation from which a line stands out among them
MAINS, WANDER = (50.0, 60.0), 0.25  # Hz, and how far off they are looked for


@dataclass(frozen=True, slots=True)
class Tone:
    """A line in the residual: angular frequency [rad/s], amplitude per output's unit, output, height over its neighbourhood."""

    omega: float
    amplitude: float
    output: int
    height: float


def tones(runs: Sequence[Run], residuals: Sequence[Array], most: int = 4) -> list[Tone]:
    """Return lines of the part of the residual that does not repeat with the excitation, tallest first.

    Without a repeating excitation, what stands out where the input has power may be the machine's own resonance: there only single lines count, at which
    no excitation has one.
    """
    clean = [np.nan_to_num(e) for e in residuals]
    listed = [(group[0][0], tone) for group in _alike(runs, clean) for tone in _lines(group)]
    listed += [(group[0][0], tone) for group in _alike(runs, clean, whole=True) for tone in _mains(group)]
    listed += [(run, tone) for run, e in zip(runs, clean, strict=True) for tone in _standing_out(run, e)]
    found: list[Tone] = []
    for run, tone in listed:
        resolution = 4 * np.pi / (len(run) * run.dt)
        same = [t for t in found if abs(t.omega - tone.omega) < resolution]
        if not same:
            found.append(tone)
        elif tone.height > same[0].height:
            found[found.index(same[0])] = tone
    return sorted(found, key=lambda t: -t.height)[:most]


def _alike(runs: Sequence[Run], residuals: Sequence[Array], whole: bool = False) -> list[list[tuple[Run, Array]]]:
    """Return runs and what does not repeat in them (or the ``whole``), those together whose spectra have the same lines."""
    groups: dict[tuple[int, float, int], list[tuple[Run, Array]]] = {}
    for run, e in zip(runs, residuals, strict=True):
        own = e if whole else _unsynchronised(run, e)
        groups.setdefault((len(own), run.dt, run.period), []).append((run, own))
    return list(groups.values())


def _mains(group: Sequence[tuple[Run, Array]]) -> list[Tone]:
    """Return the mains frequencies at which residuals of like runs tower over their neighbourhood, the excitation's lines included.

    Mains may fall on a line of the excitation, where what repeats would hide it.
    """
    run, n = group[0][0], len(group[0][1])
    seconds = n * run.dt
    found = []
    for hertz in MAINS:
        if n < 256 or not 8 / seconds < hertz < 0.4 / run.dt:
            continue
        near = np.arange(hertz - WANDER, hertz + WANDER, 0.25 / seconds)
        around = np.concatenate([hertz + s * np.arange(4, 30) / seconds for s in (-1, 1)])
        for j in range(group[0][1].shape[1]):
            sizes = [_amplitudes(run, e[:, j], near) for _, e in group]
            heights = _together([x / max(float(np.median(_amplitudes(run, e[:, j], around))), 1e-300) for x, (_, e) in zip(sizes, group, strict=True)])
            k = int(np.argmax(heights))
            size = float(np.sqrt(np.mean([x[k] ** 2 for x in sizes])))
            beside = float(np.sqrt(np.mean([_beside(r, e[:, j], float(near[k])) ** 2 for r, e in group])))
            if heights[k] > HEARD and size > 1.5 * beside:
                found.append(Tone(2 * np.pi * float(near[k]), size, j, float(heights[k])))
    return found


def _beside(run: Run, e: Array, hertz: float) -> float:
    """Return the largest amplitude at the neighbouring lines of a repeating excitation; 0 when there are none."""
    if not run.period:
        return 0.0
    orders = np.array([-3, -2, -1, 1, 2, 3]) + round(hertz * run.period * run.dt)
    return float(_amplitudes(run, e, orders / (run.period * run.dt)).max())


def _amplitudes(run: Run, e: Array, hertz: Array) -> Array:
    window = np.hanning(len(e))
    t = run.dt * np.arange(len(e))
    waves = np.exp(-2j * np.pi * np.outer(hertz, t))
    return np.asarray(2 * np.abs(waves @ (window * (e - e.mean()))) / window.sum())


def _unsynchronised(run: Run, e: Array) -> Array:
    folded = fold(run, e)
    if folded is None or folded.shape[0] < 3:
        return e
    return np.asarray((folded - folded.mean(0)).reshape(-1, e.shape[1]))


def _standing_out(run: Run, e: Array, most: int = 6) -> list[Tone]:
    """Return lines beside those of the excitation, or on one, that tower over the neighbouring lines of the excitation too."""
    if not run.period:
        return []
    tall = sorted((t for t in _lines([(run, e)], everywhere=True) if t.height > TALL), key=lambda t: -t.height)[:most]
    return [t for t in tall if t.amplitude > ALONE * _beside(run, e[:, t.output], t.omega / (2 * np.pi))]


def _lines(group: Sequence[tuple[Run, Array]], everywhere: bool = False) -> list[Tone]:
    """Return the lines that stand out in residuals of one length, taken together."""
    run, n = group[0][0], len(group[0][1])
    if n < 256:
        return []
    window = np.hanning(n)[:, None]
    sizes = [np.abs(np.fft.rfft((e - e.mean(0)) * window, axis=0)) * 4 / n for _, e in group]
    step = 1 if everywhere or not run.period else max(n // run.period, 1)
    size, heights = np.sqrt(np.mean(np.square(sizes), axis=0)), _together([_heights(s, step) for s in sizes])
    if everywhere:
        outside = np.ones(size.shape, bool)
    elif run.period:
        outside = np.broadcast_to(_between(run, n)[:, None], size.shape)
    else:
        outside = _unlike([r for r, _ in group], size, window)
    found = []
    for j in range(size.shape[1]):
        height = heights[:, j]
        for k in range(4, len(height) - 2):
            if height[k] > HEARD and height[k] == height[k - 2 : k + 3].max() and outside[k, j]:
                found.append(Tone(_centre(size[:, j], k) * 2 * np.pi / (n * run.dt), float(size[k, j]), j, float(height[k])))
    return found


def _heights(size: Array, step: int) -> Array:
    """Return sizes over the median of their neighbourhood.

    Where what repeats was taken out, every ``step``-th line is, and those beside it have lost a part: each is compared with its like.
    """
    height = size / np.maximum(running_median(size, NEIGHBOURHOOD), 1e-300)
    for k in range(step):
        height[k::step] /= np.maximum(np.median(height[k::step], axis=0), 1e-300)
    return height


def _together(heights: Sequence[Array]) -> Array:
    """Return the heights over the median at which one spectrum would be as improbable as these are together.

    Of white noise, ``log(2) height^2`` is exponential with mean one, and a sum of ``m`` of them is Gamma distributed.
    """
    if len(heights) == 1:
        return heights[0]
    power = np.maximum(np.log(2) * np.sum(np.square(heights), axis=0), 1e-300)
    less = logsumexp([i * np.log(power) - gammaln(i + 1) for i in range(len(heights))], axis=0)
    return np.asarray(np.sqrt(np.maximum(power - less, 0.0) / np.log(2)))


def _between(run: Run, n: int) -> NDArray[np.bool_]:
    """Return the bins between the lines of a repeating excitation."""
    orders = np.arange(n // 2 + 1) * run.period / n
    return np.abs(orders - np.round(orders)) > (0.6 if n >= 3 * run.period else 1.6) * run.period / n  # three periods or more tell what repeats: it is taken out


def _unlike(runs: Sequence[Run], size: Array, window: Array) -> NDArray[np.bool_]:
    """Return the bins ``(bins, p)`` where no run's excitation has power, and those of single lines of the residual where none has a line."""
    drives = [np.abs(np.fft.rfft(x[-len(window) :] * window, axis=0)) for r in runs for x in _excitations(r)]
    powered = np.any([d.max(1, initial=0.0) > 0.02 * d.max(initial=0.0) for d in drives], axis=0)
    lines = np.any([_single(d).any(1) for d in drives], axis=0)
    return np.asarray(~powered[:, None] | (_single(size) & ~lines[:, None]))


def _excitations(run: Run) -> tuple[Array, ...]:
    """Return what drives a run from outside: in feedback the references and what is added to the controller's output, where they are known, else the inputs.

    The inputs of a loop answer what disturbs its outputs, tones among it.
    """
    known = tuple(x for x in (run.W, run.REF) if x is not None and np.ptp(x, axis=0).any())
    return known or (run.U,)


def _single(size: Array) -> NDArray[np.bool_]:
    """Whether a bin towers over those beside the main lobe of its window."""
    beside = np.max([np.roll(size, k, axis=0) for k in (-4, -3, 3, 4)], axis=0)
    return np.asarray(size > ALONE * beside)


def _centre(size: Array, k: int) -> float:
    """Return the bin of a Hann-windowed line, interpolated from its neighbours."""
    a, b, c = size[k - 1], size[k], size[k + 1]
    side = 1 if c > a else -1
    ratio = (c if side > 0 else a) / b
    return float(k + side * (2 * ratio - 1) / (ratio + 1))
