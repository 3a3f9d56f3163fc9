"""The part of a residual that is periodic with the excitation: its size, the kind of lines, and its significance.

Noise does not repeat, so what repeats is the model's doing. Excited lines hold linear errors (and odd distortion), lines
left out of an odd excitation show odd and even distortion apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from afdsvc.dataset.experiment import Run
from afdsvc.dataset.periods import fold
from afdsvc.lti.statespace import Array

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
    size = np.abs(np.fft.rfft(drive, axis=0))[1 : last + 1].max(1)
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
