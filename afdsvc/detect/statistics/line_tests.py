"""Two tests on the excited lines of a burst: the largest projection, and the largest likelihood ratio.

Both are a statistic of whitened line coordinates z and a set of whitened waves, with a threshold that keeps the promised
rate for the largest over the whole set, averaged over the models the uncertainty allows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from afdsvc.detect.isolation import LineData
from afdsvc.detect.model_uncertainty import HealthyMachines, threshold_over_models
from afdsvc.detect.statistics import likelihood_ratio
from afdsvc.detect.statistics.fault_curves import FaultCurves
from afdsvc.detect.thresholds import maximum
from afdsvc.lti.statespace import Array

UNSEEN = 1e-6  # length of a wave, as a share of the longest, below which this burst cannot see the fault

Reach = Mapping[str, tuple[float, float]]


class LineTest(Protocol):
    """A test on the excited lines; statistic and threshold are in standard deviations of one matched filter."""

    def waves(self, curves: FaultCurves, data: LineData, reach: Reach) -> Array:
        """Return the whitened waves ``(K, D)`` looked for, none when the burst sees no fault."""
        ...

    def statistic(self, waves: Array, z: Array) -> float:
        """Return the statistic of whitened coordinates ``z (D,)``."""
        ...

    def threshold(self, waves: Array, data: LineData, models: HealthyMachines | None, false_alarm: float) -> float:
        """Return the threshold of the whole set."""
        ...

    def comparisons(self, waves: Array, threshold: float) -> tuple[Array, Array]:
        """Return rows ``(K, D)`` and heights ``(K,)``: the statistic exceeds the threshold where ``rows @ z`` exceeds a height."""
        ...


@dataclass(frozen=True, slots=True)
class LargestProjection:
    """``max_k <z, t_k> / |t_k|``: every fault's direction at each of the ``severities``, all at one height."""

    severities: tuple[float, ...]

    def waves(self, curves: FaultCurves, data: LineData, reach: Reach) -> Array:
        """Return the waves of all faults at the severities the loop survives."""
        found = [data.R @ curves.at(name, _within(self.severities, *bounds)) for name, bounds in reach.items()]
        return _visible(data.white_waves(np.concatenate(found)))

    def statistic(self, waves: Array, z: Array) -> float:
        """Return the largest projection."""
        return float(np.max(_unit(waves) @ z))

    def threshold(self, waves: Array, data: LineData, models: HealthyMachines | None, false_alarm: float) -> float:
        """Return the threshold of the largest projection."""
        if models is None:
            return maximum.maximum_threshold(_unit(waves), false_alarm)
        raw = np.array(np.linalg.solve(_factor(data).T, _unit(waves).T).T, dtype=np.float64)  # <raw, z> is <e, whitened z>
        return threshold_over_models(raw, models, false_alarm)

    def comparisons(self, waves: Array, threshold: float) -> tuple[Array, Array]:
        """Return the directions, all compared with the threshold."""
        return _unit(waves), np.full(len(waves), threshold)


@dataclass(frozen=True, slots=True)
class LikelihoodRatio:
    """``sqrt(2 max log likelihood ratio)`` along the curves: with one fault on a straight curve, its matched filter."""

    def waves(self, curves: FaultCurves, data: LineData, reach: Reach) -> Array:
        """Return waves on every curve, as close as the noise can distinguish."""
        found = [likelihood_ratio.waves_along(curves, name, data, _outer(bounds)) for name, bounds in reach.items()]
        return _visible(np.concatenate(found))

    def statistic(self, waves: Array, z: Array) -> float:
        """Return the signed root of the largest ratio, 0 when every ratio speaks against a fault."""
        return math.sqrt(max(2 * likelihood_ratio.statistic(waves, z), 0.0))

    def threshold(self, waves: Array, data: LineData, models: HealthyMachines | None, false_alarm: float) -> float:
        """Return the threshold of the root."""
        if models is None:
            return math.sqrt(2 * likelihood_ratio.threshold(waves, false_alarm))
        return math.sqrt(2 * likelihood_ratio.robust_threshold(waves, _factor(data), models, false_alarm))

    def comparisons(self, waves: Array, threshold: float) -> tuple[Array, Array]:
        """Return the waves, each compared with half of threshold and length squared."""
        return waves, (threshold**2 + np.sum(waves**2, axis=1)) / 2


def _factor(data: LineData) -> Array:
    return np.array(np.linalg.cholesky(np.eye(data.z.size) + data.doubt), dtype=np.float64)


def _visible(waves: Array) -> Array:
    length = np.linalg.norm(waves, axis=1)
    return np.asarray(waves[length > UNSEEN * max(length.max(initial=0.0), 1e-12)])


def _unit(waves: Array) -> Array:
    return np.asarray(waves / np.linalg.norm(waves, axis=1)[:, None])


def _outer(bounds: tuple[float, float]) -> float:
    """Return the end of a range that is farther from 0."""
    low, high = bounds
    return low if abs(low) > abs(high) else high


def _within(severities: Sequence[float], low: float, high: float) -> list[float]:
    """Return the severities the loop survives; the largest survivable one when it survives none of them."""
    return [s for s in severities if low <= s <= high] or [_outer((low, high))]
