"""Periodic disturbance: a tone from outside, such as mains or a neighbouring machine."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal, Size
from afdsvc.plugins.physics.attach import at_force, at_input, at_output, force


def tone_on_signal(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``a cos(w t) + b sin(w t)`` beside the signal itself."""
    out[0] += p[1] * math.cos(p[0] * z[1]) + p[2] * math.sin(p[0] * z[1])


def _tone(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``a cos(w t) + b sin(w t)`` as a force."""
    out[0] += p[1] * math.cos(p[0] * z[0]) + p[2] * math.sin(p[0] * z[0])


class PeriodicDisturbance:
    """A tone at every input, axis and output, at the frequencies of the lines the excitation does not explain."""

    name = "periodic_disturbance"
    summary = "a tone from outside the loop"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per site and line of the residual; none when the residual has no lines."""
        for number, w in enumerate(machine.tones[:3]):
            for port in machine.outputs:
                scale = 0.3 * float(machine.residual[port.index])
                yield at_output(port, tone_on_signal, [Signal("t")], **self._parts(machine, w, number, self._pair(port, scale)))
            for port in machine.inputs:
                yield at_input(port, tone_on_signal, [Signal("t")], **self._parts(machine, w, number, self._pair(port, 0.05 * port.rms)))
            for axis in machine.axes:
                scale = 0.05 * axis.push
                pair = [force(axis, f"{part} amplitude", -1e3 * scale, 1e3 * scale, scale, linear=True) for part in ("cosine", "sine")]
                yield at_force(axis, _tone, [Signal("t")], **self._parts(machine, w, number, pair))

    def _pair(self, port: Size, scale: float) -> list[Coefficient]:
        return [
            Coefficient(f"{part} amplitude", port.unit, -1e3 * scale, 1e3 * scale, scale, linear=True) for part in ("cosine", "sine")
        ]

    def _parts(self, machine: Machine, w: float, number: int, pair: list[Coefficient]) -> dict[str, Any]:
        width = 4 * math.pi / machine.duration
        return {
            "physics": self.name, "family": "tone",
            "parameters": [Coefficient("frequency", "rad/s", w - width, w + width, 0.02 * width), *pair],
            "starts": [(w, 0.0, 0.0)], "notes": {"variant": str(number)} if number else {},
            "predicts": "one line in the residual that does not repeat with the excitation",
            "refuted_by": "a line that moves with the rotor speed or with the excitation",
        }
