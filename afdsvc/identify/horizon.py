"""How far subspace methods look back and ahead."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.dataset.arrays import Recording
from afdsvc.lti.statespace import ComplexArray

SHORTEST, LONGEST = 15, 60
#: Windows wanted for every entry of a window.
_WINDOWS_PER_ENTRY = 4


def choose_horizon(recordings: Sequence[Recording], slowest: float, windows: int = 2) -> int:
    """Return block rows that cover the slowest time constant (in samples), as far as the recordings allow.

    ``windows`` is 2 for past and future of equal length, 1 for a past window only. Between `SHORTEST` and `LONGEST`
    (times two for a past window only), fewer when the recordings are short.
    """
    channels = recordings[0].u.shape[1] + recordings[0].y.shape[1]
    samples = sum(map(len, recordings))
    affordable = samples // (windows * (_WINDOWS_PER_ENTRY * channels + 1))
    longest = LONGEST * (2 if windows == 1 else 1)
    return int(max(4, min(np.clip(np.ceil(slowest), SHORTEST, longest), affordable)))


def memory(poles: ComplexArray) -> float:
    """Return the slowest time constant of discrete poles, in samples."""
    radius = float(np.abs(poles).max(initial=0.0))
    return float(-1 / np.log(np.clip(radius, 1e-6, 1 - 1e-6)))


def samples_needed(inputs: int, outputs: int, order: int) -> int:
    """Return how many samples are the least for a model of some order: windows for the smallest horizon that shows
    it."""
    horizon = max(SHORTEST, -(-order // outputs) + 2)
    return 2 * horizon * (_WINDOWS_PER_ENTRY * (inputs + outputs) + 1)
