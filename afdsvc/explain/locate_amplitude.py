"""The amplitude law: with which power of the excitation the residual grows from one level to the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.dataset.experiment import Run

APART = 1.2  # ratio between levels from which a law can be read off
ODD_ONE_OUT = 4.0  # standard errors by which the exponent must differ from 1 to count


@dataclass(frozen=True, slots=True)
class Law:
    """Residual rms ~ excitation rms to the power ``exponent``, with its standard error, from that many recordings."""

    exponent: float
    sd: float
    recordings: int

    @property
    def nonlinear(self) -> bool:
        """Whether the exponent is not 1."""
        return abs(self.exponent - 1.0) > max(ODD_ONE_OUT * self.sd, 0.15)

    @property
    def reading(self) -> str:
        """What such an exponent means."""
        if not self.nonlinear:
            return "in proportion, as a linear error does"
        if self.exponent < 1:
            return "less than in proportion, as friction, a dead zone or a disturbance of its own does"
        return "more than in proportion, as a hardening stiffness does"


def law(runs: Sequence[Run], sizes: Sequence[tuple[float, float]]) -> Law | None:
    """Return the law of what repeats in one output, ``sizes`` its rms and standard error per run; None without two levels."""
    drive = np.array([_level(r) for r in runs])
    size, error = np.array(sizes).T
    use = (drive > 0) & (size > 0) & (error > 0)
    if use.sum() < 2 or drive[use].max() < APART * drive[use].min():
        return None
    x, y = np.log(drive[use]), np.log(size[use])
    weight = 1 / ((error[use] / size[use]) ** 2 + 1e-4)
    middle = (weight * x).sum() / weight.sum()
    spread = float((weight * (x - middle) ** 2).sum())
    slope = float((weight * (x - middle) * y).sum() / spread)
    return Law(slope, float(1 / np.sqrt(spread)), int(use.sum()))


def _level(run: Run) -> float:
    """Return the rms of the excitation: what was added to the controller's output, or the input about its mean."""
    signal = run.W if run.W is not None else run.U
    return float(np.sqrt(np.mean((signal - signal.mean(0)) ** 2)))
