"""Settings of detectors: unknown keys and values out of range are refused by name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from afdsvc.detect.features.nuisances import Nuisances
from afdsvc.detect.features.whiteness_gate import Gate
from afdsvc.errors import BadInput


@dataclass(frozen=True, slots=True)
class Range:
    """A number's default and the range it must lie in; ``whole`` numbers only when said so."""

    default: float
    low: float
    high: float
    whole: bool = False


COMMON: Mapping[str, Range] = {
    "sure": Range(0.99, 0.5, 1.0),  # weight that singles a fault out
    "gate_level": Range(1e-3, 1e-9, 0.5),  # share of decisions on good data that the gate refuses
    "gate_lags": Range(20, 1, 200, whole=True),
    "gate_window": Range(2500, 100, 1e7, whole=True),  # quiet samples remembered
    "frozen_samples": Range(100, 3, 1e7, whole=True),  # a sensor equal for so long stands still
}

NUISANCES: Mapping[str, Range] = {
    "drift": Range(0, 0, 1, whole=True),  # 1: constant and slope are taken out
    "mains_hz": Range(0.0, 0.0, 1000.0),  # 0: no interference at mains frequency
    "mains_harmonics": Range(3, 1, 20, whole=True),
    "rotor_orders": Range(-1, -1, 20, whole=True),  # multiples of the rotor angle; -1: two when it is recorded
}


def nuisances_of(values: Mapping[str, float], dt: float) -> Nuisances:
    """Return what the nuisance settings take out of every residual."""
    hz, orders = values["mains_hz"], int(values["rotor_orders"])
    harmonics = range(1, int(values["mains_harmonics"]) + 1)
    mains = tuple(2 * math.pi * hz * k for k in harmonics if 0 < hz * k < 0.5 / dt)
    return Nuisances(bool(values["drift"]), mains, tuple(range(1, abs(2 * orders if orders < 0 else orders) + 1)), orders < 0)


def read(detector: str, settings: Mapping[str, Any], own: Mapping[str, Range]) -> dict[str, float]:
    """Return all values, defaults filled in; raises `BadInput` naming a key that is unknown or a value out of range."""
    known = {**COMMON, **own}
    for key in settings:
        if key not in known:
            raise BadInput(f"detector '{detector}' has no setting '{key}'; it has {', '.join(sorted(known))}")
    return {key: _checked(detector, key, settings.get(key, r.default), r) for key, r in known.items()}


def gate_of(values: Mapping[str, float]) -> Gate:
    """Return the gate the common settings describe."""
    return Gate(values["gate_level"], int(values["gate_lags"]), int(values["gate_window"]))


def _checked(detector: str, key: str, value: Any, r: Range) -> float:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not r.low <= value <= r.high or (r.whole and value != int(value)):
        kind = "whole number" if r.whole else "number"
        raise BadInput(f"detector '{detector}': {key} = {value!r}; expected a {kind} between {r.low:g} and {r.high:g}")
    return float(value)
