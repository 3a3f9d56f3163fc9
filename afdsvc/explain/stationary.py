"""Whether what does not repeat is noise: noise is as loud at every level of excitation, an unmodelled modulation is not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from afdsvc.dataset.experiment import Run
from afdsvc.explain.noise import wandering
from afdsvc.lti.statespace import Array
from afdsvc.stats.ar_noise import correlation_time

SURE = 1e-6
LOUDER = 1.1  # ratio of excitations from which two recordings have different levels
GROWTH = 1.08  # ratio of powers from which it matters


@dataclass(frozen=True, slots=True)
class Growth:
    """What does not repeat, louder in one recording than in another: output, both recordings, ratio of powers, p-value."""

    output: int
    loud: str
    quiet: str
    ratio: float
    p: float

    @property
    def matters(self) -> bool:
        """Whether it is neither chance nor small."""
        return self.p < SURE and self.ratio > GROWTH


def growth(runs: Sequence[Run], residuals: Sequence[Array]) -> Growth | None:
    """Return the surest difference between recordings in what does not repeat; None when fewer than two recordings tell."""
    known = [(r, w) for r, e in zip(runs, residuals, strict=True) if (w := wandering([r], [e]))]
    if len(known) < 2:
        return None
    found = [_of_output(known, j) for j in range(runs[0].Y.shape[1])]
    return min(found, key=lambda g: g.p)


def _of_output(known: Sequence[tuple[Run, Sequence[Array]]], j: int) -> Growth:
    powers, freedoms = [], []
    for _, pieces in known:
        x = np.vstack([p[:, [j]] - p[:, j].mean() for p in pieces])
        powers.append(float((x**2).mean()))
        freedoms.append(x.size * (len(pieces) - 1) / len(pieces) / correlation_time(x))
    levels = [float(np.nanstd(r.U, axis=0).max()) for r, _ in known]
    a, b = int(np.argmax(powers)), int(np.argmin(powers))
    if levels[a] <= LOUDER * levels[b]:  # what does not grow with the excitation is noise that is not the same every day
        return Growth(j, known[a][0].name, known[b][0].name, 1.0, 1.0)
    ratio = powers[a] / max(powers[b], 1e-300)
    p = min(1.0, len(known) ** 2 * float(stats.f.sf(ratio, freedoms[a], freedoms[b])))
    return Growth(j, known[a][0].name, known[b][0].name, ratio, p)
