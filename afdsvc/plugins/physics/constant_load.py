"""Constant load: a force or an input offset that is always there, or that changes steadily."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_force, at_input, force


def _load(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``+F``."""
    out[0] += p[0]


def drifting(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``F + rate t``, ``t`` since the recording began."""
    out[0] += p[0] + p[1] * m[0]
    m[0] += dt


_STEADY: dict[str, Any] = {
    "predicts": "a shift of the mean that is the same at every level", "refuted_by": "a mean that follows the level or the direction of motion",
}
_DRIFT: dict[str, Any] = {
    "memory": 1, "notes": {"variant": "drifting", "of": ""},
    "predicts": "a shift of the mean that grows steadily with time", "refuted_by": "a mean that is the same at the beginning and at the end",
}


class ConstantLoad:
    """Weight, preload or offset, constant or drifting: on every axis, and on every input that drives no axis at once. Without inputs none drifts (see `ParameterDrift`)."""

    name = "constant_load"
    summary = "a constant force, such as weight, preload or an amplifier offset"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return two hypotheses per axis, and two per input whose offset is not a force on an axis."""
        words: dict[str, Any] = {"physics": self.name, "family": "offset"}
        for axis in machine.axes:
            f = 0.05 * axis.push
            size = force(axis, "force", -400 * f, 400 * f, f, linear=True)
            rate = force(axis, "rate", -400 * f / machine.duration, 400 * f / machine.duration, f / machine.duration, "s", linear=True)
            yield at_force(axis, _load, [], parameters=[size], starts=[(0.0,)], **words, **_STEADY)
            if machine.inputs:
                yield at_force(axis, drifting, [], parameters=[size, rate], starts=[(0.0, 0.0)], **words, **_DRIFT)
        driven = {axis.input for axis in machine.axes}
        for port in machine.inputs:
            if port.index not in driven:
                f = 0.05 * port.rms
                size = Coefficient("offset", port.unit, -400 * f, 400 * f, f, linear=True)
                rate = Coefficient("rate", f"{port.unit}/s", -400 * f / machine.duration, 400 * f / machine.duration, f / machine.duration, linear=True)
                yield at_input(port, _load, parameters=[size], starts=[(0.0,)], **words, **_STEADY)
                yield at_input(port, drifting, parameters=[size, rate], starts=[(0.0, 0.0)], **words, **_DRIFT)
