"""The range of severities for which the closed loop stays stable."""

from __future__ import annotations

import numpy as np

from afdsvc.api.detection import DetectionProblem
from afdsvc.lti.lft import fault_signature

STEPS = 64


def reachable(problem: DetectionProblem) -> dict[str, tuple[float, float]]:
    """Return for every fault the severities, from 0 outwards, up to which the loop stays stable.

    Inside the stated range; the border is found to a millionth of it.
    """
    return problem.once(lambda: _borders(problem), "stability range")


def _borders(problem: DetectionProblem) -> dict[str, tuple[float, float]]:
    low, high = problem.severity_range
    return {name: (_border(problem, name, low), _border(problem, name, high)) for name in problem.fault_names}


def _border(problem: DetectionProblem, fault: str, end: float) -> float:
    """Return the severity between 0 and ``end`` where stability is first lost, ``end`` when it is not."""
    if end == 0:
        return 0.0
    inside = 0.0
    for severity in np.linspace(0, end, STEPS + 1)[1:].tolist():
        if not _stable(problem, fault, severity):
            return _bisected(problem, fault, inside, severity)
        inside = severity
    return end


def _bisected(problem: DetectionProblem, fault: str, inside: float, outside: float) -> float:
    for _ in range(14):
        middle = (inside + outside) / 2
        if _stable(problem, fault, middle):
            inside = middle
        else:
            outside = middle
    return inside


def _stable(problem: DetectionProblem, fault: str, severity: float) -> bool:
    return fault_signature(problem.augmented, problem.interconnection, {fault: severity}).is_stable()
