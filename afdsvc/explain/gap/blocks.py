"""Correlation time of the residual, and the contiguous blocks that are left out in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from afdsvc.explain.gap.settings import GapSettings
from afdsvc.lti.statespace import Array

IntArray = NDArray[np.int64]


def bartlett_time(pieces: Sequence[Array], lag_share: float) -> Array:
    """Return per output ``sum_k rho_k^2`` over all lags [samples]: 1 for white noise, T for ``rho_k = exp(-|k| / T)``.

    It divides the number of samples in the variance of a correlation between two series of this colour (Bartlett's formula),
    and counts the envelope of an oscillation, which ``sum_k rho_k`` does not. ``pieces`` are ``(n, p)``, NaN counting as zero.
    """
    most = max(1, int(lag_share * max(len(e) for e in pieces)))
    total = sum(_autocovariance(np.nan_to_num(e), most) for e in pieces)
    power = np.where(np.asarray(total)[0] > 0, np.asarray(total)[0], 1.0)
    return np.asarray(1 + 2 * ((np.asarray(total)[1:] / power) ** 2).sum(0))


def _autocovariance(e: Array, most: int) -> Array:
    spectrum = np.fft.rfft(e, 2 * len(e), axis=0)
    found = np.fft.irfft(np.abs(spectrum) ** 2, axis=0)[: min(most, len(e)) + 1]
    return np.asarray(np.pad(found, ((0, most + 1 - len(found)), (0, 0))))


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Blocks of rows over all recordings.

    Attributes
    ----------
    edges : list of (start, stop)
        Rows of each block, in order; no block crosses from one recording to the next.
    recording : (blocks,)
        Recording of each block.
    fold : (blocks,)
        Which blocks are left out together.
    apart : int
        Rows next to a left-out block that are not fitted either.
    """

    edges: list[tuple[int, int]]
    recording: IntArray
    fold: IntArray
    apart: int

    @property
    def folds(self) -> int:
        """Number of left-out parts."""
        return int(self.fold[-1]) + 1

    def rows(self, fold: int) -> IntArray:
        """Return the rows of a fold."""
        return np.concatenate([np.arange(*self.edges[b]) for b in np.flatnonzero(self.fold == fold)])

    def neighbours(self, fold: int) -> IntArray:
        """Return the rows beside a fold, in the same recordings, that are not fitted when it is left out."""
        own = self.rows(fold)
        beside: set[int] = set()
        for b in np.flatnonzero(self.fold == fold):
            start, stop = self.edges[b]
            first, last = self.extent(int(self.recording[b]))
            beside.update(range(max(first, start - self.apart), start), range(stop, min(last, stop + self.apart)))
        return np.array(sorted(beside - set(own.tolist())), dtype=np.int64)

    def fold_of(self, recording: int, rows: IntArray) -> IntArray:
        """Return the fold of rows counted from the start of a recording; rows past its end belong to its last block."""
        mine = np.flatnonzero(self.recording == recording)
        starts = np.array([self.edges[b][0] for b in mine]) - self.edges[mine[0]][0]
        return np.asarray(self.fold[mine[np.searchsorted(starts, rows, side="right") - 1]])

    def extent(self, recording: int) -> tuple[int, int]:
        """Return first row and last row + 1 of a recording."""
        mine = np.flatnonzero(self.recording == recording)
        return self.edges[mine[0]][0], self.edges[mine[-1]][1]


def contiguous_blocks(lengths: Sequence[int], correlation: float, settings: GapSettings) -> Blocks:
    """Return the blocks of recordings with these numbers of rows; ``correlation`` is their correlation time in rows.

    Blocks are as long as `GapSettings.block_times` asks where this leaves as many as are needed, else shorter.
    """
    total = sum(lengths)
    count = float(np.clip(total / (settings.block_times * correlation), settings.needed_blocks, settings.folds))
    edges, recording, at = [], [], 0
    for i, n in enumerate(lengths):
        cuts = at + np.linspace(0, n, max(1, round(n * count / total)) + 1).astype(int)
        edges += [(int(a), int(b)) for a, b in pairwise(cuts)]
        recording += [i] * (len(cuts) - 1)
        at += n
    middle = np.array(edges).mean(1) / total
    fold = np.unique((middle * count).astype(int), return_inverse=True)[1]
    return Blocks(edges, np.array(recording), fold, int(min(correlation, total / count / 4)))
