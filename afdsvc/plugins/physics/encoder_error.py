"""Encoder error: a reading of a position or a speed that is off by the same amount at the same place of every period."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal, Size
from afdsvc.lti.statespace import Array
from afdsvc.plugins.physics.attach import (
    MOST,
    at_machine,
    at_output,
    constant,
    least_wave,
    orders,
    placed,
    quantity,
    radians,
    radians_per_second,
    turn_periods,
)


def at_angle(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``e = a cos(n q) + b sin(n q)``, ``q`` the angle, one unit of it ``p[1]`` rad (1 along a line); where the speed is read from the same encoder, it is off by
    ``de/dt``."""
    k = p[0] * p[1]
    c, s = math.cos(k * z[0]), math.sin(k * z[0])
    out[0] += p[2] * c + p[3] * s
    if len(out) > 1:
        out[1] += k * (p[3] * c - p[2] * s) * z[1]


def by_speed(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """A share ``p[2] m[0]`` of the speed, which turns ``p[0]`` times as far as the shaft; one unit of speed is ``p[1]`` rad/s, ``m[2]`` the speed before."""
    angle = p[0] * p[1] * 0.5 * (m[2] + z[0]) * dt
    c, s = math.cos(angle), math.sin(angle)
    m[0], m[1], m[2] = c * m[0] - s * m[1], s * m[0] + c * m[1], z[0]
    out[0] += p[2] * m[0] * z[0]


WORDS: dict[str, Any] = {
    "physics": "encoder_error", "family": "ripple", "predicts": "an error that repeats along the way, the same at every speed",
    "refuted_by": "an error that grows with the acceleration, or whose frequency does not follow the speed",
}


class EncoderError:
    """An eccentric disc, the lines of an encoder, the pitch of a screw: at outputs that are positions or speeds of shafts, and at both where one encoder
    gives both."""

    name = "encoder_error"
    summary = "a reading that is off by the same amount at the same place of every turn or period"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per output that is a position or a speed of a shaft, and per pair of angle and speed; it begins at whole periods per turn, along
        a line at those that the residual shows.

        An angle has to travel a whole turn, a line two periods: in less nothing repeats, and a wave stands for any curve.
        """
        for port in machine.outputs:
            if quantity(port.unit) == "angle":
                yield from _of_angle([port], machine)
            elif quantity(port.unit) == "length" and (waves := [k for k in machine.waves.get(Signal("y", port.index), ()) if k >= least_wave(port)]):
                lowest = max(0.5 * min(waves), least_wave(port))
                wave, size = Coefficient("wave number", f"rad/{port.unit}", lowest, 2 * max(waves), 1e-3 * min(waves)), 0.2 * float(machine.residual[port.index])
                yield at_output(port, at_angle, parameters=[wave, constant("unit", "", 1.0), *_parts(port, size)], starts=[(k, 1.0, 0.0, 0.0) for k in waves], **WORDS)
            elif (unit := radians_per_second(port.unit)) and (numbers := orders(unit * (size := max(port.rms, abs(port.mean))), machine.dt)):
                yield at_output(
                    port, by_speed, memory=3, unsettled=2, lasting=True, parameters=[*turn_periods(unit), Coefficient("share", "", 1 / size, 1 / size, 1 / size)],
                    starts=[(n, unit, 1 / size) for n in numbers], **WORDS,
                )
        for axis, q in placed(machine):
            pair = [o for s in (q, axis.rate) for o in machine.outputs if machine.plant is not None and _reads(machine.plant.C[o.index], s.index)]
            if len(pair) == 2 and quantity(pair[0].unit) == "angle":
                yield from _of_angle(pair, machine)


def _reads(row: Array, state: int) -> bool:
    """Whether an output is a state."""
    return bool(row[state] == 1 and np.count_nonzero(row) == 1)


def _parts(port: Size, scale: float) -> list[Coefficient]:
    return [Coefficient(f"{part} part", port.unit, -1e3 * scale, 1e3 * scale, scale, linear=True) for part in ("cosine", "sine")]


def _of_angle(ports: Sequence[Size], machine: Machine) -> Iterator[Hypothesis]:
    angle = ports[0]
    unit, travelled, scale = radians(angle.unit), 2 * (angle.peak - abs(angle.mean)), 0.2 * float(machine.residual[angle.index])
    starts = [(float(n), unit, 0.0, 0.0) for n in range(1, MOST + 1)] if unit * travelled > 2 * math.pi else []
    words: dict[str, Any] = {"parameters": [*turn_periods(unit), *_parts(angle, scale)], "starts": starts, **WORDS}
    both = [Signal("y", p.index) for p in ports]
    if starts and len(ports) == 1:
        yield at_output(angle, at_angle, **words)
    elif starts:
        yield at_machine("output", at_angle, both, both, notes={"variant": " and ".join(p.name for p in ports)}, **words)
