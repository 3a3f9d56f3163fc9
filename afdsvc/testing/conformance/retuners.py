"""Retuners: a proportional loop of the gas bearing with a weak actuator. A plugin for other machines offers ``example`` settings."""

from __future__ import annotations

from typing import Any

import numpy as np

from afdsvc.api.retuning import DiagnosedFault
from afdsvc.lti.lft import star
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import retuned_interconnection
from afdsvc.retune.cost import loop_cost
from afdsvc.testing.conformance.named import settings_check, settings_of
from afdsvc.testing.machines import bearing_problem

FOUND = DiagnosedFault("horizontal_actuator", -0.35, -0.25)


def _designed(thing: Any) -> StateSpace:
    problem = bearing_problem("proportional")
    Q = thing.design(problem, FOUND, _cost(problem), settings_of(thing))
    assert isinstance(Q, StateSpace), f"design returned {type(Q).__name__}; expected a StateSpace"
    return Q


def _cost(problem: Any) -> Any:
    return loop_cost(problem, {"process_weight": 0.01 * problem.plant.B @ problem.plant.B.T})


def _use(thing: Any, settings: dict[str, Any]) -> Any:
    problem = bearing_problem("proportional")
    return thing.design(problem, FOUND, _cost(problem), settings)


def has_the_shape_of_q(thing: Any) -> None:
    """Q goes from beta to alpha, at the plant's sample time, and every number of it is finite."""
    Q = _designed(thing)
    assert (Q.outputs, Q.inputs) == (2, 2), f"Q is {Q.outputs} x {Q.inputs}; expected 2 x 2"
    assert Q.dt == bearing_problem().plant.dt, f"Q has sample time {Q.dt}; expected that of the plant"
    assert all(np.isfinite(M).all() for M in (Q.A, Q.B, Q.C, Q.D)), "a matrix of Q is not finite"


def q_is_stable(thing: Any) -> None:
    """Q is stable: if the diagnosis is wrong, the healthy machine is."""
    worst = float(np.abs(_designed(thing).poles()).max(initial=0.0))
    assert worst < 1, f"Q has a pole of modulus {worst:.6g}"


def the_damaged_machine_is_stable(thing: Any) -> None:
    """The loop with Q is stable over the interval of the severity."""
    problem, Q = bearing_problem("proportional"), _designed(thing)
    J = retuned_interconnection(problem.interconnection, Q)
    for severity in np.linspace(FOUND.low, FOUND.high, 5).tolist():
        worst = float(np.abs(star(problem.augmented.close({FOUND.fault: severity}), J, 2, 2).poles()).max())
        assert worst < 1, f"at {100 * severity:.3g} % the loop has a pole of modulus {worst:.6g}"


CHECKS = (settings_check(_use), has_the_shape_of_q, q_is_stable, the_damaged_machine_is_stable)
