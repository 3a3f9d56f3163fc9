"""Hysteresis: the effect depends on the way taken, not only on where one is."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Law, Machine, Signal, Size
from afdsvc.plugins.physics.attach import at_force, at_input, at_output, force, imposed, placed, quantity, state, summed


def bouc_wen(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``a s`` with ``ds = dw (1 - (1 + sgn(dw s)) / 2 |s|^n) / width``: a rate-independent loop between -a and a."""
    w = z[len(z) - 1]
    if m[2] == 0.0:
        m[1], m[2] = w, 1.0
    step = (w - m[1]) / p[1]
    m[1] = w
    pieces = min(int(abs(step) / 0.2) + 1, 20)
    d = step / pieces
    for _ in range(pieces):
        full = abs(m[0]) ** p[2] if d * m[0] > 0 else 0.0
        m[0] = min(max(m[0] + d * (1 - full), -1.0), 1.0)
    out[0] += p[0] * m[0]


def bouc_wen_turned(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``a s`` with ``ds = dw (1 - cos(b) |s|^n) / width`` on the way out and ``dw (1 + sin(b) |s|^n) / width`` on the way back.

    Angle 0 is the loop above; between 90 and 135 degrees it stiffens the further it goes and dissipates all the same.
    """
    w = z[len(z) - 1]
    if m[2] == 0.0:
        m[1], m[2] = w, 1.0
    step = (w - m[1]) / p[1]
    m[1] = w
    pieces = min(int(abs(step) / 0.1) + 1, 40)
    d, outwards, back = step / pieces, math.cos(p[3]), math.sin(p[3])
    for _ in range(pieces):
        s = m[0]
        for part in range(1, 3):  # midpoint rule
            full = abs(s) ** p[2]
            slope = 1.0 - outwards * full if d * s > 0 else 1.0 + back * full
            s = m[0] + d * slope * 0.5 * part
        m[0] = min(max(s, -1e3), 1e3)
    out[0] += p[0] * m[0]


def over_integral(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """`bouc_wen` over the way a velocity makes."""
    step = z[len(z) - 1] * dt / p[1]
    pieces = min(int(abs(step) / 0.2) + 1, 20)
    d = step / pieces
    for _ in range(pieces):
        full = abs(m[0]) ** p[2] if d * m[0] > 0 else 0.0
        m[0] = min(max(m[0] + d * (1 - full), -1.0), 1.0)
    out[0] += p[0] * m[0]


def _shape(size: Size) -> list[Coefficient]:
    r = size.rms
    return [
        Coefficient("width", size.unit, 0.01 * r, 20 * r, 0.1 * r),
        Coefficient("exponent", "", 0.4, 4.0, 0.1, nuisance=True),
    ]


Form = tuple[Law, list[Coefficient], dict[str, Any]]


def _forms(machine: Machine, size: Size, widths: tuple[float, ...]) -> Iterable[Form]:
    """Yield law, shape and words of the loop with one shape; where the noise leaves more to be seen, also of one that may turn."""
    r = size.rms
    if quantity(size.unit) == "velocity":
        way = r / machine.bandwidth
        width = Coefficient("width", summed(size.unit), 1e-3 * way, 1e3 * way, 0.1 * way)
        yield over_integral, [width, _shape(size)[1]], {"starts": [(0.0, w * way, 1.0) for w in (0.3, 3.0, 30.0)]}
        return
    yield bouc_wen, _shape(size), {"starts": [(0.0, w * r, 1.0) for w in widths]}
    if machine.limited == "model":
        turn = Coefficient("turn", "rad", -math.pi / 4, 3 * math.pi / 4, 0.1, nuisance=True)
        starts = [(0.0, w * r, 1.0, b) for w in (0.5 * widths[0], *widths) for b in (0.5, 1.2, 1.8)]
        yield bouc_wen_turned, [*_shape(size), turn], {"starts": starts, "notes": {"variant": "turned", "of": ""}}


class Hysteresis:
    """A rate-independent loop at every input, between position and force on every axis, in a force that answers an imposed motion, and in a reading of what
    a state sums up, as in the voltage of a cell that was charged or discharged.

    Where the input is a velocity, the loop goes over the way.
    """

    name = "hysteresis"
    summary = "a rate-independent loop: the effect depends on the way taken"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per input, axis and imposed motion, with loops narrow and wide against the motion."""
        words: dict[str, Any] = {
            "physics": self.name, "family": "memory", "memory": 3,
            "predicts": "odd distortion with a lag that does not depend on frequency, and a loop that depends on the level",
            "refuted_by": "a lag that grows with frequency, or a residual that does not depend on the level",
        }
        for port in machine.inputs:
            r = port.rms
            size = Coefficient("amplitude", port.unit, -5 * r, 5 * r, 0.05 * r, linear=True)
            for law, shape, form in _forms(machine, port, (0.3, 1.0, 3.0)):
                yield at_input(port, law, parameters=[size, *shape], **form, **words)
        for axis, q in placed(machine):
            loop = force(axis, "force", -20 * axis.push, 20 * axis.push, -0.1 * axis.push, linear=True)
            for law, shape, form in _forms(machine, q, (0.1, 0.5, 2.0)):
                yield at_force(axis, law, [state(q)], parameters=[loop, *shape], **form, **words)
        for port, u, low, high in (*imposed(machine, "velocity"), *imposed(machine, "length"), *imposed(machine, "angle")):
            f = port.rms
            loop = Coefficient("force", port.unit, 20 * low * f, 20 * high * f, 0.1 * f, linear=True)
            law, shape, form = next(iter(_forms(machine, u, (0.1, 0.5, 2.0))))
            yield at_output(port, law, [Signal("u", u.index)], parameters=[loop, *shape], notes={"variant": u.name}, **form, **words)
        for port, x in _sums(machine):
            loop = Coefficient("amplitude", port.unit, -5 * port.rms, 5 * port.rms, 0.05 * port.rms, linear=True)
            law, shape, form = next(iter(_forms(machine, x, (0.1, 0.5, 2.0))))
            yield at_output(port, law, [state(x)], parameters=[loop, *shape], notes={"variant": x.name}, **form, **words)


def _sums(machine: Machine) -> Iterable[tuple[Size, Size]]:
    """Yield every output with every state that it depends on and that only sums up what comes in, such as the charge of a cell; motion aside."""
    moving = {s.index for a in machine.axes for s in (a.rate, a.position) if s}
    if machine.plant is None:
        return
    for x in machine.states:
        if x.index not in moving and not machine.plant.A[x.index].any():
            for port in machine.outputs:
                if machine.plant.C[port.index, x.index]:
                    yield port, x
