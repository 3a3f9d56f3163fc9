"""Parameter step: a number of the model that changes at one moment, as where a part fails, and keeps its new value."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from afdsvc.api.physics import LONG_AGO, Coefficient, Hypothesis, Machine, Signal
from afdsvc.plugins.physics.attach import constant
from afdsvc.plugins.physics.parameter_change import ParameterChange, inertia

TIME = Signal("t")
MOMENTS = (0.25, 0.5, 0.75)  # of the time that the recordings span, where fits begin
LONGEST, FIRST = 0.25, 0.2  # of that time, that the change may take (what takes longer is a drift), and takes where fits begin
LEAST, MOST = -0.99, 1.0  # a number keeps its sign and at most doubles, as one that drifts
SIDES = 0.1  # of that time, at least, on either side of the moment: a change at the very beginning or end stands for the start of a recording, or its end
FIXED = 3  # constants of the model come after the change, its moment and how long it takes


def stepping(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """Terms ``1 + p[0]`` times as large after the moment ``p[1]``; the change takes ``p[2]`` seconds. ``p[3:]`` are coefficients, time comes last in ``z``.
    Where there is no other signal, ``p[0]`` is added.

    With a memory, of the time at which the recording began, it is undone where the next recording begins; a moment before all recordings
    (`LONG_AGO`) has come in each of them.
    """
    share = min(max((z[-1] - p[1]) / p[2] + 0.5, 0.0), 1.0)
    if len(m) > 1:
        if m[1] == 0.0:
            m[0], m[1] = z[-1], 1.0
        if -1e299 < p[1] < m[0]:
            share = 0.0
    total = 1.0 if len(z) == 1 else 0.0
    for k in range(len(z) - 1):
        total += p[3 + k] * z[k]
    out[0] += p[0] * share * share * (3 - 2 * share) * total


def stepping_inertia(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """A mass ``1 + p[0]`` times as large after the moment ``p[1]``: every acceleration divided by that, otherwise as in ``stepping``."""
    share = min(max((z[-1] - p[1]) / p[2] + 0.5, 0.0), 1.0)
    if len(m) > 1:
        if m[1] == 0.0:
            m[0], m[1] = z[-1], 1.0
        if -1e299 < p[1] < m[0]:
            share = 0.0
    change = p[0] * share * share * (3 - 2 * share)
    total = 0.0
    for k in range(len(z) - 1):
        total += p[3 + k] * z[k]
    out[0] -= total * change / (1 + change)


class ParameterStep:
    """Gain of every input and output; of code every parameter that is not known exactly, of matrices stiffness, damping and mass of every axis.

    Where there are several recordings, also undone before the next one: a part that was repaired, or recordings in another order.

    The improved model has the number as it is after the change.
    """

    name = "parameter_step"
    summary = "a number of the model that changes at one moment and keeps its new value"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one or two hypotheses per number and place."""
        for h in ParameterChange().over_time(machine):
            law = stepping_inertia if h.law is inertia else stepping
            yield from once_or_for_good(replace(h, law=law, reads=(*h.reads, TIME), linear=_after(h), **self._course(machine, h)), machine)

    def _course(self, machine: Machine, h: Hypothesis) -> dict[str, Any]:
        numbers, starts = coming(machine)
        change, constants = h.parameters[0], h.parameters[1:] or (constant("nominal", "", 1.0),)
        return {
            "physics": self.name, "family": "drift",
            "parameters": (replace(change, low=max(change.low, LEAST), high=MOST), *numbers, *constants),
            "starts": tuple((0.0, *start, *(c.low for c in constants)) for start in starts),
            "predicts": "a residual that begins at one moment, in proportion to the part of the model that this number governs",
            "refuted_by": "a residual that is the same at the beginning and at the end",
        }


def coming(machine: Machine) -> tuple[tuple[Coefficient, Coefficient], list[tuple[float, float]]]:
    """Return the moment at which a change comes and the time that it takes, and where fits begin."""
    begin, end = machine.span or (0.0, machine.duration)
    whole = end - begin
    moment = Coefficient("moment", "s", begin + SIDES * whole, end - SIDES * whole, 0.1 * whole, later=LONG_AGO)
    takes = Coefficient("time it takes", "s", machine.dt, LONGEST * whole, 0.1 * whole, nuisance=True, decisive=True)
    return (moment, takes), [(begin + share * whole, FIRST * whole) for share in MOMENTS]


def once_or_for_good(h: Hypothesis, machine: Machine) -> Iterable[Hypothesis]:
    """Return a change that lasts, and where there are several recordings, one that is undone before the next one."""
    yield h
    if machine.recordings > 1:
        variant = h.notes.get("variant", "")
        yield replace(h, memory=2, notes={**h.notes, "variant": f"{variant}, in one recording" if variant else "in one recording", "of": h.notes.get("of", "")})


def _after(h: Hypothesis) -> Any:
    """Return how a plant is built with a change as it is after its moment."""
    build, own = h.linear, len(h.parameters) - 1
    return build and (lambda plant, values: build(plant, (values[0], *values[FIXED : FIXED + own])))
