"""Memoisation of computations shared by the detectors of one machine.

Detectors are pure and know nothing of each other, but most run the same filters over the same samples. The last results of
such a step are kept and found again by the identity of what it was given, so nothing is compared and nothing can be stale:
values here are never changed in place, and what was given is kept as long as the result.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import ResidualBlock
from afdsvc.lti.statespace import Array

T = TypeVar("T")


class Once:
    """Remembers the last ``size`` results. Safe in several threads: at worst something is computed twice."""

    def __init__(self, size: int = 4) -> None:
        self._size = size
        self._kept: tuple[tuple[tuple[Any, ...], Any], ...] = ()

    def __call__(self, work: Callable[..., T], *given: Any) -> T:
        """Return ``work(*given)``, or what it returned before for the very same objects (arrays: the same memory; whole
        numbers: the same number)."""
        for before, result in self._kept:
            for a, b in zip(before, given, strict=True):
                if a is not b and not _same(a, b):
                    break
            else:
                return result  # type: ignore[no-any-return]
        result = work(*given)
        self._kept = ((given, result), *self._kept[: self._size - 1])
        return result


class Filters(Protocol):
    """Filters from the samples of a block to the series detectors look at."""

    def start(self) -> Any:
        """Return the state at rest."""
        ...

    def step(self, state: Any, r: Array, y: Array, u: Array) -> tuple[Any, Array]:
        """Return the state after the samples and the series."""
        ...


class Counting(Protocol):
    """Something counted along the outputs, like `checks.Runs`."""

    def add(self, y: Array) -> tuple[Any, Array]:
        """Return the counts after the samples ``y (n, p)`` and what was found in them."""
        ...


_RESTING, _STEPPED, _COUNTED = Once(256), Once(8), Once(8)


def counted(runs: Counting, block: ResidualBlock) -> tuple[Any, Array]:
    """Return the counts after the block's outputs and what was found in them."""
    return _COUNTED(_count, runs, block)


def _count(runs: Counting, block: ResidualBlock) -> tuple[Any, Array]:
    return runs.add(block.y)


def at_rest(filters: Filters) -> Any:
    """Return the filters' state at rest, one object for all who ask."""
    return _RESTING(type(filters).start, filters)


def stepped(filters: Filters, state: Any, block: ResidualBlock) -> tuple[Any, Array]:
    """Return the filters' state after the block and the series, computed by the first detector that asks."""
    return _STEPPED(_step, filters, state, block)


def _step(filters: Filters, state: Any, block: ResidualBlock) -> tuple[Any, Array]:
    return filters.step(state, block.r, block.y, block.u)


@dataclass(frozen=True, slots=True)
class Played:
    """A burst by what is played, whatever it is called: every burst has a name of its own, most are alike."""

    burst: Burst = field(compare=False)
    content: tuple[object, ...]

    @classmethod
    def of(cls, burst: Burst) -> Played:
        """Return the burst as a key."""
        waveform = b"" if burst.waveform is None else burst.waveform.tobytes()
        return cls(burst, (burst.inputs, burst.samples, burst.ramp, burst.settle, burst.lines, waveform))


def _same(a: Any, b: Any) -> bool:
    if type(a) is int:
        return type(b) is int and a == b
    if type(a) is not np.ndarray or type(b) is not np.ndarray:
        return False
    return a.shape == b.shape and a.strides == b.strides and a.__array_interface__["data"] == b.__array_interface__["data"]
