"""Back-EMF: the voltage of a turning motor drives its current through a coil, less what the motion induces."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Machine
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.actuator_lag import behind_lag
from afdsvc.plugins.physics.attach import at_input, constant, velocity


def _coil(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``tau w' + w = u - e v``; w replaces ``u``, or ``u - h v`` where the model has a damping ``b h`` by induction. ``p = (tau, e, h)``.

    Exact for an input and a velocity held over the step, that of its middle by extrapolation; the mean of w is what acts.
    """
    middle = z[1] + 0.5 * (z[1] - m[1]) * m[2]
    m[1], m[2] = z[1], 1.0
    goal = z[0] - p[1] * middle
    decay, rest = math.exp(-dt / p[0]), m[0] - goal
    out[0] += goal + rest * (1 - decay) * p[0] / dt - z[0] + p[2] * middle
    m[0] = goal + rest * decay


def _coupled(plant: StateSpace, values: Sequence[float], port: int, speed: int) -> StateSpace:
    lagging = behind_lag(plant, values, port)
    A, C = lagging.A.copy(), lagging.C.copy()
    A[:-1, speed] += values[2] * A[:-1, -1]
    C[:, speed] += values[2] * C[:, -1]
    A[-1, speed] -= values[1] / values[0]
    return StateSpace(A, lagging.B, C, lagging.D)


class BackEmf:
    """A coil between every input and the axis it drives at once."""

    name = "back_emf"
    summary = "an electrical lag of the force, with a voltage induced by the motion"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return per axis the coil with a new induced voltage, and where the model has damping, with that as the induced voltage."""
        for axis in machine.axes:
            if axis.input is None or not axis.gain:
                continue
            damping = 0.0 if machine.plant is None else max(-float(machine.plant.A[axis.rate.index, axis.rate.index]), 0.0)
            several = sum(a.input == axis.input for a in machine.axes) > 1
            yield self._on(axis, machine, 0.0, {"variant": axis.rate.name} if several else {})
            if damping:
                own = f" of {axis.rate.name}" if several else ""
                yield self._on(axis, machine, damping / axis.gain, {"variant": f"the model's damping{own}", "of": ""})

    def _on(self, axis: Axis, machine: Machine, induced: float, notes: dict[str, str]) -> Hypothesis:
        port, span = machine.inputs[axis.input or 0], 1 / machine.bandwidth
        scale = math.copysign(0.05 * port.rms / axis.rate.rms, axis.gain)  # what is induced acts against the motion
        unit = f"{port.unit}/({axis.rate.unit})"
        low, high = sorted((0.0, 100 * scale))
        voltage = constant("induced per speed", unit, induced) if induced else Coefficient("induced per speed", unit, low, high, abs(scale))
        first = (induced,) if induced else (scale, 10 * scale)
        return at_input(
            port, _coil, [velocity(axis)], physics=self.name, family="timing", memory=3, unsettled=1, substeps=4, notes=notes,
            parameters=[Coefficient("time constant", "s", 1e-3 * span, 300 * span, 0.05 * span), voltage, constant("in the model", unit, induced)],
            starts=[(s * span, e, induced) for s in (0.1, 1.0, 10.0) for e in first],
            linear=lambda plant, values: _coupled(plant, values, port.index, axis.rate.index),
            predicts="a lag of the force whose size depends on whether the axis may move", refuted_by="the same lag with the axis held and free",
        )
