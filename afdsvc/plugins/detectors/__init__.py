"""Built-in detectors."""

from __future__ import annotations

from collections.abc import Iterable

from afdsvc.api.detection import DetectorDesign
from afdsvc.plugins.detectors.baselines import DESIGNS as BASELINES
from afdsvc.plugins.detectors.burst_detectors import (
    FaultCurvesDesign,
    IteratedRegressionDesign,
    MatchedFilterDesign,
    RegressionDesign,
)
from afdsvc.plugins.detectors.cusum import ActiveCusumDesign, PassiveCusumDesign
from afdsvc.plugins.hookspecs import hookimpl


@hookimpl
def afdsvc_detectors() -> Iterable[DetectorDesign]:
    """Return the built-in detectors; the last five are there to be compared with."""
    return [
        MatchedFilterDesign(), FaultCurvesDesign(), RegressionDesign(), IteratedRegressionDesign(), ActiveCusumDesign(),
        PassiveCusumDesign(), *BASELINES,
    ]  # fmt: skip
