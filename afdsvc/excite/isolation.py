"""Isolability: the burst, or pair of bursts, that distinguishes every two faults, computed in advance."""

from __future__ import annotations

import math
from itertools import combinations
from typing import Any

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.thresholds.power import weight_reached
from afdsvc.errors import AfdsvcError, Refused
from afdsvc.excite.diagnosis_burst import second_burst
from afdsvc.excite.expected_detection import ExpectedDetection, burst_detection
from afdsvc.excite.settings import BURST

NOT_ISOLABLE = "not isolable"


def isolable_pairs(problem: DetectionProblem, burst: Burst, severity: float) -> list[dict[str, Any]]:
    """Return one entry for every pair of faults of the given severity.

    ``isolated_by`` names the burst, or the burst and the second one that follows it, after which the right one of the two
    gets a weight of 0.99 with ``probability``; ``"not isolable"`` when not even a second burst made for the two, as large as
    the limits allow, does it with 0.99. ``separation`` is the smaller distance in standard deviations of the noise from
    one fault to the other's curve. ``second_burst`` describes the second burst where one is needed.
    """
    seen = burst_detection(problem, burst)
    return [_pair(problem, seen, burst, pair, severity) for pair in combinations(problem.fault_names, 2)]


def _pair(
    problem: DetectionProblem, seen: ExpectedDetection, burst: Burst, pair: tuple[str, str], severity: float
) -> dict[str, Any]:
    first = separation(seen, pair, severity)
    entry: dict[str, Any] = {"faults": list(pair), "severity": severity, "second_burst": None}
    if sure(first):
        return {**entry, **_entry(first, burst.name)}
    try:
        second = _second(problem, burst, pair, severity)
        reached = separation(burst_detection(problem, second), pair, severity)
    except AfdsvcError as error:
        return {**entry, **_entry(first, NOT_ISOLABLE), "why": str(error)}
    described = {
        "burst": second.name, "separation": reached, "seconds": second.samples * problem.plant.dt,
        "lines": [{"input": line.input, "rad_s": line.omega, "amplitude": line.amplitude} for line in second.lines],
    }  # fmt: skip
    if not sure(reached):
        why = f"{reached:.3g} standard deviations apart with the largest second burst the limits allow"
        return {**entry, **_entry(max(first, reached), NOT_ISOLABLE), "second_burst": described, "why": why}
    return {**entry, **_entry(reached, f"{burst.name}, then {second.name}"), "second_burst": described}


def separation(seen: ExpectedDetection, pair: tuple[str, str], severity: float) -> float:
    """Return the smaller of the two distances from one fault of that severity to the other's curve.

    A fault that makes the loop unstable at that severity is taken at nine tenths of what the loop survives.
    """
    a, b = pair
    return min(seen.separation(a, _survived(seen, a, severity), b), seen.separation(b, _survived(seen, b, severity), a))


def sure(apart: float) -> bool:
    """Whether faults so far apart are isolated."""
    return weight_reached(apart, BURST.isolating_weight) >= BURST.isolation_probability


def _second(problem: DetectionProblem, burst: Burst, pair: tuple[str, str], severity: float) -> Burst:
    if problem.limits is None:
        raise Refused(f"machine '{problem.machine}' states no limits; a second burst is planned within them")
    seconds = burst.samples * problem.plant.dt
    return second_burst(problem, problem.limits, dict.fromkeys(pair, 0.5), severity, seconds)


def _entry(apart: float, isolated_by: str) -> dict[str, Any]:
    finite = apart if math.isfinite(apart) else None
    return {"separation": finite, "probability": weight_reached(apart, BURST.isolating_weight), "isolated_by": isolated_by}


def _survived(seen: ExpectedDetection, fault: str, severity: float) -> float:
    low, high = seen.reach[fault]
    return severity if low <= severity <= high else 0.9 * low
