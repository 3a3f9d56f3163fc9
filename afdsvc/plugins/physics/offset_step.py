"""Offset step: a load, or a bias of an actuator or a sensor, that begins at one moment: `stepping` of no signal."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_force, at_input, at_output, force
from afdsvc.plugins.physics.parameter_step import TIME, coming, once_or_for_good, stepping


class OffsetStep:
    """On every axis, every input that drives no axis at once, and every output. None of a machine without inputs (see `ParameterDrift`)."""

    name = "offset_step"
    summary = "a load, or a bias of an actuator or a sensor, that begins at one moment and stays"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one or two hypotheses per place."""
        if not machine.inputs:
            return
        for axis in machine.axes:
            f = 0.05 * axis.push
            size = force(axis, "force", -400 * f, 400 * f, f, linear=True)
            yield from once_or_for_good(at_force(axis, stepping, [TIME], **self._course(machine, size)), machine)
        driven = {axis.input for axis in machine.axes}
        for place, ports in ((at_input, [p for p in machine.inputs if p.index not in driven]), (at_output, machine.outputs)):
            for port in ports:
                scale = 0.05 * port.rms
                size = Coefficient("offset", port.unit, -400 * scale, 400 * scale, scale, linear=True)
                yield from once_or_for_good(replace(place(port, stepping, **self._course(machine, size)), reads=(TIME,)), machine)

    def _course(self, machine: Machine, size: Coefficient) -> dict[str, Any]:
        numbers, starts = coming(machine)
        return {
            "physics": self.name, "family": "drift", "parameters": [size, *numbers], "starts": [(0.0, *start) for start in starts],
            "predicts": "a shift of the mean that begins at one moment, whatever the excitation", "refuted_by": "a mean that is the same at the beginning and at the end",
        }
