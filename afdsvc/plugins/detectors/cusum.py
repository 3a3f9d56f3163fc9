"""CUSUM during bursts, and between them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from afdsvc.api.detection import DetectionProblem, Detector
from afdsvc.detect.burst_detector import burst_detector
from afdsvc.detect.settings import NUISANCES, Range, gate_of, nuisances_of, read
from afdsvc.detect.statistics.active_cusum import ActiveCusum
from afdsvc.detect.statistics.passive_cusum import passive_detector


class ActiveCusumDesign:
    """Settings besides the common ones: ``deflection`` of the smallest waves looked for, over a whole burst (0: what a test
    at its end would find with probability 0.99), and what is projected out, as for ``fault_curves``."""

    name = "cusum"
    summary = "sequential test during a burst: alarms before the burst ends when the fault is large"

    def design(self, problem: DetectionProblem, settings: Mapping[str, Any]) -> Detector:
        """Return the detector; raises `BadInput` for a setting that is unknown or out of range."""
        values = read(self.name, settings, {**NUISANCES, "deflection": Range(0.0, 0.0, 100.0)})
        out, frozen = nuisances_of(values, problem.plant.dt), int(values["frozen_samples"])
        statistic = ActiveCusum(problem, values["deflection"], out)
        gate = gate_of(values)
        return burst_detector(self.name, problem, statistic, gate, values["sure"], frozen, nuisances=out, regressing=False)


class PassiveCusumDesign:
    """Settings besides the common ones: ``severity`` of the fault looked for, ``silence_seconds`` after an alarm, and what
    is projected out, as for ``fault_curves``."""

    name = "passive_cusum"
    summary = "sequential test between bursts on what the loop's own noise reveals"
    passive = True

    def design(self, problem: DetectionProblem, settings: Mapping[str, Any]) -> Detector:
        """Return the detector; raises `BadInput` for a setting that is unknown or out of range."""
        own = {**NUISANCES, "severity": Range(-0.3, -1.0, -0.001), "silence_seconds": Range(10.0, 0.0, 1e6)}
        values = read(self.name, settings, own)
        return passive_detector(
            self.name, problem, gate_of(values), values["severity"], values["silence_seconds"], values["sure"],
            int(values["frozen_samples"]), nuisances_of(values, problem.plant.dt),
        )
