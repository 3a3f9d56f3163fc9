"""Sets of integers as sorted half-open intervals: which samples are there."""

from __future__ import annotations

from bisect import bisect_left, bisect_right


class Intervals:
    """A set of integers that grows by intervals ``[start, end)``; neighbours are joined."""

    def __init__(self) -> None:
        self._starts: list[int] = []
        self._ends: list[int] = []

    def add(self, start: int, end: int) -> None:
        """Add the integers from ``start`` up to, and without, ``end``."""
        if end <= start:
            return
        i, j = bisect_left(self._ends, start), bisect_right(self._starts, end)
        if i < j:
            start, end = min(start, self._starts[i]), max(end, self._ends[j - 1])
        self._starts[i:j], self._ends[i:j] = [start], [end]

    def covers(self, start: int, end: int) -> bool:
        """Whether all integers from ``start`` up to, and without, ``end`` are in the set."""
        i = bisect_right(self._starts, start) - 1
        return end <= start or (i >= 0 and end <= self._ends[i])

    def pairs(self) -> list[tuple[int, int]]:
        """Return the intervals in order."""
        return list(zip(self._starts, self._ends, strict=True))
