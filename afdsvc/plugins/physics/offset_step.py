"""Offset step: a load, or a bias of an actuator or a sensor, that begins at one moment."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_force, at_input, at_output, force
from afdsvc.plugins.physics.parameter_step import TIME, coming


def beginning(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``p[0]`` after the moment ``p[1]``; the change takes ``p[2]`` seconds. Time comes last in ``z``.

    With a memory, of the time at which the recording began, it is undone where the next recording begins.
    """
    share = min(max((z[-1] - p[1]) / p[2] + 0.5, 0.0), 1.0)
    if len(m) > 1:
        if m[1] == 0.0:
            m[0], m[1] = z[-1], 1.0
        if -1e299 < p[1] < m[0]:
            share = 0.0
    out[0] += p[0] * share * share * (3 - 2 * share)


class OffsetStep:
    """On every axis, every input that drives no axis at once, and every output. None of a machine without inputs (see `ParameterDrift`)."""

    name = "offset_step"
    summary = "a load, or a bias of an actuator or a sensor, that begins at one moment and stays"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one or two hypotheses per place."""
        if not machine.inputs:
            return
        driven = {axis.input for axis in machine.axes}
        for axis in machine.axes:
            f = 0.05 * axis.push
            yield from self._at(machine, force(axis, "force", -400 * f, 400 * f, f, linear=True), lambda rest, axis=axis: at_force(axis, beginning, [TIME], **rest))
        for place, ports in ((at_input, [p for p in machine.inputs if p.index not in driven]), (at_output, machine.outputs)):
            for port in ports:
                scale = 0.05 * port.rms
                offset = Coefficient("offset", port.unit, -400 * scale, 400 * scale, scale, linear=True)
                yield from self._at(machine, offset, lambda rest, place=place, port=port: place(port, beginning, [TIME], **rest))

    def _at(self, machine: Machine, size: Coefficient, placed: Any) -> Iterable[Hypothesis]:
        numbers, starts = coming(machine)
        rest: dict[str, Any] = {
            "physics": self.name, "family": "drift", "parameters": [size, *numbers], "starts": [(0.0, *start) for start in starts],
            "predicts": "a shift of the mean that begins at one moment, whatever the excitation", "refuted_by": "a mean that is the same at the beginning and at the end",
        }
        yield placed(rest)
        if machine.recordings > 1:
            yield placed(rest | {"memory": 2, "notes": {"variant": "in one recording", "of": ""}})
