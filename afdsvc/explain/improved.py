"""The improved model as matrices, where everything that was found is linear."""

from __future__ import annotations

from afdsvc.explain.nominal import Nominal
from afdsvc.explain.objective import Point
from afdsvc.lti.statespace import StateSpace


def extended(nominal: Nominal, point: Point) -> StateSpace | None:
    """Return the plant at the final point with its linear effects built in; None when an effect is not linear.

    Effects are built in from the sensors inwards and from the inputs outwards, so that row and column numbers of the machine
    stay valid: extensions append states and keep the order of inputs and outputs.
    """
    plant = nominal.at(point.theta)
    order = {"force": 0, "input": 1, "output": 2}
    for effect in sorted(point.effects, key=lambda e: order[e.hypothesis.stage]):
        build = effect.hypothesis.linear
        if build is None or plant.discrete:
            return None
        plant = build(plant, [float(v) for v in effect.values])
    return plant
