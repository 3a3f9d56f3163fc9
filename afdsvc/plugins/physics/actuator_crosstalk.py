"""Actuator cross-talk: an input that also drives what another input drives."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.attach import at_state


def _share(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``+c u``."""
    out[0] += p[0] * z[0]


def _driven(plant: StateSpace, values: Sequence[float], row: int, column: int) -> StateSpace:
    B = plant.B.copy()
    B[row, column] += values[0]
    return replace(plant, B=B)


class ActuatorCrosstalk:
    """A share of one input in what drives a state beside another input, for every input and every state that others drive at once."""

    name = "actuator_crosstalk"
    summary = "an input that also drives what another input drives"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per driven state and input that the model's matrices do not let act there."""
        if machine.plant is None or machine.code or machine.plant.discrete:
            return
        for where, row in zip(machine.states, machine.plant.B, strict=True):
            pushes = np.abs(row) * [port.rms for port in machine.inputs]
            if not pushes.any():
                continue
            own = machine.inputs[int(pushes.argmax())]
            for port in machine.inputs:
                if row[port.index] == 0:
                    scale = 0.05 * float(pushes.max()) / port.rms
                    unit = "" if own.unit == port.unit else f"{own.unit}/{port.unit}"
                    yield at_state(
                        where, _share, [Signal("u", port.index)], physics=self.name, family="coupling",
                        parameters=[Coefficient(f"share of {port.name}", unit, -200 * scale, 200 * scale, scale, linear=True, through=(where.index, own.index))],
                        starts=[(0.0,)], linear=lambda plant, values, i=where.index, j=port.index: _driven(plant, values, i, j),
                        notes={"variant": port.name},
                        predicts="a linear response to this input with the dynamics of what the other input drives",
                        refuted_by="a response with dynamics of its own, or one that the reading of the other axis explains as well",
                    )
