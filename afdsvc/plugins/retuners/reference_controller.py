"""The Q of a controller that somebody has tuned for the damaged machine."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from afdsvc.api.detection import DetectionProblem
from afdsvc.api.retuning import DiagnosedFault, LoopCost
from afdsvc.errors import BadInput, Refused
from afdsvc.lti.stability import describe_pole, is_stable, worst_pole
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import youla_parameter


class ReferenceController:
    """Settings: ``A``, ``B``, ``C``, ``D`` of K in positive feedback u = K y, at the plant's sample time; ``D`` alone is a static gain."""

    name = "reference_controller"
    summary = "the Q that makes the loop's controller exactly the one given by its matrices"

    def design(self, problem: DetectionProblem, found: DiagnosedFault, cost: LoopCost, settings: Mapping[str, Any]) -> StateSpace:
        """Return Q, of the orders of J_K and K together; raises `Refused` where K does not hold the healthy machine."""
        for key in settings:
            if key not in ("A", "B", "C", "D"):
                raise BadInput(f"reference_controller: unknown setting '{key}'; known are A, B, C, D")
        if "D" not in settings:
            raise BadInput("reference_controller: setting 'D' is missing; expected the matrices A, B, C, D of the controller")
        dt, plant = problem.plant.dt, problem.plant
        static = StateSpace.gain(settings["D"], dt)
        K = StateSpace.of(settings["A"], settings["B"], settings["C"], settings["D"], dt) if "A" in settings else static
        if K.D.shape != (plant.inputs, plant.outputs):
            raise BadInput(f"reference_controller: the controller is {K.outputs} x {K.inputs}; expected {plant.inputs} x {plant.outputs}")
        Q = youla_parameter(problem.interconnection, K)
        if not is_stable(Q.A, dt):
            pole = describe_pole(worst_pole(Q.A, dt)[0], dt)
            raise Refused(f"the reference controller does not hold the healthy machine (pole {pole}), so no stable Q realises it")
        return Q
