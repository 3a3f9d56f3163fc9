"""Periodic disturbance: a tone from outside, such as mains or a neighbouring machine."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_force, at_input, at_output, force, velocity


def oscillation(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``p1`` times an oscillation at ``p0`` rad/s that goes on as the recording began with it."""
    out[0] += p[1] * m[0]
    c, s = math.cos(p[0] * dt), math.sin(p[0] * dt)
    m[0], m[1] = c * m[0] - s * m[1], s * m[0] + c * m[1]


class PeriodicDisturbance:
    """A tone at every input, axis and output, at the frequencies of the lines the excitation does not explain.

    Its amplitude and its phase are those of the recording: no clock connects a tone from outside with the excitation.
    """

    name = "periodic_disturbance"
    summary = "a tone from outside the loop"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per site and line of the residual; none when the residual has no lines."""
        for number, w in enumerate(machine.tones[:3]):
            for port in machine.outputs:
                yield at_output(port, oscillation, **self._parts(machine, w, number, Coefficient("amplitude", port.unit, 1.0, 1.0, 1.0)))
            for port in machine.inputs:
                yield at_input(port, oscillation, **self._parts(machine, w, number, Coefficient("amplitude", port.unit, 1.0, 1.0, 1.0)))
            for axis in machine.axes:
                unit = axis.push / (axis.rate.rms or 1.0)
                yield at_force(axis, oscillation, [velocity(axis)], **self._parts(machine, w, number, force(axis, "amplitude", unit, unit, unit)))

    def _parts(self, machine: Machine, w: float, number: int, size: Coefficient) -> dict[str, Any]:
        width = 16 * math.pi / machine.duration  # lines are found in single recordings, several times shorter than all together
        return {
            "physics": self.name, "family": "tone", "memory": 2, "unsettled": 2, "lasting": True,
            "parameters": [Coefficient("frequency", "rad/s", w - width, w + width, 0.02 * width), size], "starts": [(w, size.low)],
            "notes": {"variant": str(number)} if number else {},
            "predicts": "one line in the residual that does not repeat with the excitation",
            "refuted_by": "a line that moves with the rotor speed or with the excitation",
        }
