"""The resolution of a quantised reading."""

from __future__ import annotations

import numpy as np

from afdsvc.lti.statespace import Array


def grid(column: Array) -> float:
    """Return the step of the grid the values lie on: at most half of them may differ, and all differences be multiples."""
    values = np.unique(column)
    if not 3 <= len(values) <= len(column) / 2:
        return 0.0
    gaps = np.diff(values)
    step = float(gaps.min())
    multiples = gaps / step
    return step if np.abs(multiples - np.round(multiples)).max() < 0.02 * max(1.0, float(np.median(multiples))) else 0.0
