"""Rotation of a simulated rotor: speed and angle over time, linear between given points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array

REFRESH = 50  # samples after which the plant of a rotor that runs up or down is taken anew


@dataclass(frozen=True, slots=True, eq=False)
class SpeedProfile:
    """Speed [rad/s] at given samples, linear in between, constant before the first and after the last.

    ``samples (q,)`` rise from 0; ``speeds (q,)``.
    """

    dt: float
    samples: NDArray[np.int64]
    speeds: Array

    @classmethod
    def of(cls, points: Sequence[Sequence[float]], start: float, dt: float) -> SpeedProfile:
        """Return the profile through ``(second, rad/s)``, at ``start`` until the first; raises `BadInput` unless times rise."""
        seconds = [p[0] for p in points]
        if any(b <= a for a, b in pairwise(seconds)) or (seconds and seconds[0] < 0):
            raise BadInput(f"speed profile at {seconds} s; expected rising times from 0 s")
        whole = [(0.0, points[0][1] if points else start), *(p for p in points if p[0] > 0)]
        return cls(dt, np.array([round(p[0] / dt) for p in whole], dtype=np.int64), np.array([float(p[1]) for p in whole]))

    @property
    def turning(self) -> bool:
        """Whether the rotor turns at all."""
        return bool(self.speeds.any())

    def at(self, k: NDArray[np.int64]) -> Array:
        """Return the speed at samples ``k (n,)``."""
        return np.asarray(np.interp(k, self.samples, self.speeds))

    def angle(self, k: NDArray[np.int64]) -> Array:
        """Return the angle [rad] in [0, 2 pi) at samples ``k (n,)``: the integral of the speed."""
        if len(self.samples) == 1 or np.ptp(self.speeds) == 0:
            return np.asarray(np.mod(self.speeds[0] * self.dt * k, 2 * np.pi))
        length = np.diff(self.samples) * self.dt
        turned = np.concatenate([[0.0], np.cumsum(length * (self.speeds[1:] + self.speeds[:-1]) / 2)])
        i = np.clip(np.searchsorted(self.samples, k, side="right") - 1, 0, len(self.samples) - 1)
        since = (k - self.samples[i]) * self.dt
        return np.asarray(np.mod(turned[i] + since * (self.speeds[i] + self.at(k)) / 2, 2 * np.pi))

    def steps(self, k: int, n: int) -> set[int]:
        """Return the samples from ``k`` on, fewer than ``n`` later, at which the plant is taken anew."""
        due: set[int] = set()
        for a, b in self._ramps():
            low, high = max(a, k), min(b, k + n - 1)
            due |= set(range(-(-low // REFRESH) * REFRESH, high + 1, REFRESH)) | ({b} & set(range(k, k + n)))
        return due

    def _ramps(self) -> list[tuple[int, int]]:
        """Return first and last sample of every stretch on which the speed changes."""
        ends = zip(pairwise(self.samples.tolist()), pairwise(self.speeds.tolist()), strict=True)
        return [(a, b) for (a, b), (before, after) in ends if before != after]
