"""Constant load: a force or an input offset that is always there."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_force, at_input, force


def load(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``+F``."""
    out[0] += p[0]


class ConstantLoad:
    """Weight, preload or offset: on every axis, or on every input of a machine without axes."""

    name = "constant_load"
    summary = "a constant force, such as weight, preload or an amplifier offset"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis, or per input when no axis is known."""
        words: dict[str, Any] = {
            "predicts": "a shift of the mean that is the same at every level",
            "refuted_by": "a mean that follows the level or the direction of motion",
        }
        for axis in machine.axes:
            scale = 0.05 * axis.push
            yield at_force(
                axis, load, [], physics=self.name, family="offset", starts=[(0.0,)],
                parameters=[force(axis, "force", -400 * scale, 400 * scale, scale, linear=True)], **words,
            )
        for port in machine.inputs if not machine.axes else ():
            scale = 0.05 * port.rms
            yield at_input(
                port, load, physics=self.name, family="offset", starts=[(0.0,)],
                parameters=[Coefficient("offset", port.unit, -400 * scale, 400 * scale, scale, linear=True)], **words,
            )
