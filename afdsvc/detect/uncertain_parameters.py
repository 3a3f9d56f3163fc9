"""Stated uncertainty of a model's parameters, checked."""

from __future__ import annotations

import math

from afdsvc.api.detection import DetectionProblem
from afdsvc.errors import BadInput


def uncertain_parameters(problem: DetectionProblem) -> dict[str, float]:
    """Return relative standard deviations by parameter; raises `BadInput` for one the uncertain plant does not know."""
    known = () if problem.uncertain is None else problem.uncertain.fault_names
    for name, sd in problem.uncertainty.items():
        if name not in known:
            raise BadInput(f"uncertain parameter '{name}' is not one of {', '.join(known) or 'none'}")
        if not (math.isfinite(sd) and sd >= 0):
            raise BadInput(f"uncertain parameter '{name}': relative standard deviation {sd}; expected 0 or more")
    return {name: sd for name, sd in problem.uncertainty.items() if sd > 0}
