"""Shares with their intervals, and the tables they are shown in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Result = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ReportTable:
    """A table with a title, a sentence that says what is in it, headings and rows of text."""

    title: str
    note: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def share(hits: int, count: int) -> str:
    """Return hits of count with the 95 % interval of Wilson, as text."""
    if not count:
        return "-"
    low, high = wilson(hits, count)
    return f"{hits} of {count} ({100 * hits / count:.0f} %, {100 * low:.0f} to {100 * high:.0f})"


def wilson(hits: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """Return the interval of Wilson for a share (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    p, n = hits / count, count
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))
