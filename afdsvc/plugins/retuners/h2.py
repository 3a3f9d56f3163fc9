"""The cheapest Q over the interval of the severity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from afdsvc.api.detection import DetectionProblem
from afdsvc.api.retuning import DiagnosedFault, LoopCost
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import StateSpace
from afdsvc.retune.design import design_q
from afdsvc.retune.settings import RETUNE, stated


class H2:
    """Settings: those of `afdsvc.retune.settings.RetuneSettings` by name, such as ``doubt``, ``sensitivity`` and ``models``."""

    name = "h2"
    summary = "smallest quadratic cost over the interval of the severity, lowest order, stable also in the healthy machine"

    def design(self, problem: DetectionProblem, found: DiagnosedFault, cost: LoopCost, settings: Mapping[str, Any]) -> StateSpace:
        """Return Q; raises `Refused` where nothing worthwhile can be gained."""
        names = [f.name for f in fields(RETUNE)]
        for key in settings:
            if key not in names:
                raise BadInput(f"h2: unknown setting '{key}'; known are {', '.join(names)}")
        return design_q(problem, found, cost, stated(settings))
