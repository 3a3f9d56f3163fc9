"""Static nonlinearity: a curved characteristic of an input or of a flow between states."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Law, Machine, Signal, Size
from afdsvc.plugins.physics.attach import at_input, at_state, constant, downstream, operating_point, state, store_states


def _curve(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``a2 w^2 + a3 w^3`` in units of the rms ``r``: ``w = z / r``, times r."""
    w = z[0] / p[2]
    out[0] += (p[0] * w * w + p[1] * w * w * w) * p[2]


def curve_about(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """`_curve` of the deviation from an operating point c, ``p = (a2, a3, r, c, shift)``: the model's gain holds there, its zero need not."""
    w = (z[0] - p[3]) / p[2]
    out[0] += (p[0] * w * w + p[1] * w * w * w) * p[2] - p[4]


def power(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The input becomes ``r |u / r|^n`` with its sign, ``p = (r, n)``: the model's gain holds at the level r."""
    out[0] += math.copysign(p[0] * (abs(z[0]) / p[0]) ** p[1], z[0]) - z[0]


def power_from(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """`power` of what exceeds a threshold, ``p = (r, n, d)``: a drive that starts at d and whose gain then rises or falls."""
    out[0] += math.copysign(p[0] * (max(abs(z[0]) - p[2], 0.0) / p[0]) ** p[1], z[0]) - z[0]


def signed_square(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``u + a u |u| / r``."""
    out[0] += p[0] * z[0] * abs(z[0]) / p[1]


def two_slopes(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``u + a |u|``: one gain forwards, another backwards, as of a cylinder with a rod."""
    out[0] += p[0] * abs(z[0])


def thrust(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """A rotor follows the input, ``tau w' + w = u``, and pushes with ``w |w| / r``: the model's gain holds at the level r."""
    rest = (m[0] - z[0]) * math.exp(-0.5 * dt / p[1])
    w = z[0] + rest
    m[0] = z[0] + rest * math.exp(-0.5 * dt / p[1])
    out[0] += w * abs(w) / p[0] - z[0]


def outflow(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """A flow in proportion to ``x`` goes as ``r (x / r)^n`` instead, ``p = (n, r)``; no step takes more than there is. ``p[2]`` is
    the model's rate, ``p[3:]`` what arrives elsewhere per unit lost."""
    flow = min(p[1] * (abs(z[0]) / p[1]) ** p[0], max(abs(z[0]), abs(z[0]) / (p[2] * dt)))
    change = p[2] * (math.copysign(flow, z[0]) - z[0])
    out[0] -= change
    for k in range(1, len(out)):
        out[k] += p[2 + k] * change


def outflow_about(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """`outflow` where ``x`` is the deviation from a level r at which the model's rate holds: ``r ((1 + x / r)^n - 1) / n``."""
    change = p[2] * (p[1] / p[0] * (max(1.0 + z[0] / p[1], 0.0) ** p[0] - 1.0) - z[0])
    out[0] -= change
    for k in range(1, len(out)):
        out[k] += p[2 + k] * change


_POLYNOMIAL: dict[str, Any] = {
    "predicts": "even and odd distortion that grows with the square and the cube of the level",
    "refuted_by": "distortion whose share falls as the level rises",
}
_CURVED: dict[str, Any] = {
    "predicts": "a gain that follows a power of the level, the same at every frequency", "refuted_by": "a gain that is the same at every level",
}


class StaticNonlinearity:
    """Curved characteristics of every input, of every flow out of a store, and of every state of a machine without axes of motion."""

    name = "static_nonlinearity"
    summary = "a smooth curved characteristic without memory"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return several hypotheses per input and per store, and one per state where no axis is known."""
        words: dict[str, Any] = {"physics": self.name, "family": "input curve"}
        for port in machine.inputs:
            for law, name, parameters, starts in _polynomials(port, "", 1.0):
                yield at_input(port, law, parameters=parameters, starts=starts, description=True, notes=_shape(name), **words, **_POLYNOMIAL)
            if not port.reverses:
                yield at_input(port, curve_about, description=True, **_about(port, "", 1.0), **words, **_POLYNOMIAL)
            level, exponent = _level(port), Coefficient("exponent", "", 0.2, 4.0, 0.1)
            yield at_input(
                port, power, parameters=[level, exponent], description=True, notes=_shape("power"),
                starts=[(r * port.rms, n) for r in (0.5, 1.5) for n in (0.5, 1.5, 2.0, 3.0)], **words, **_CURVED,
            )
            yield at_input(
                port, power_from, parameters=[level, exponent, Coefficient("threshold", port.unit, 0.0, 0.9 * port.peak, 0.05 * port.peak)], description=True,
                notes=_shape("power from a threshold"), starts=[(port.rms, n, d * port.peak) for n in (0.4, 0.7, 1.5) for d in (0.05, 0.15, 0.4)],
                predicts="no answer below a level, and a gain that follows the level above it", refuted_by="an answer to the smallest input", **words,
            )
            yield at_input(
                port, power, parameters=[level, constant("exponent", "", 2.0)], notes=_shape("thrust"),
                starts=[(r * port.rms, 2.0) for r in (0.3, 1.0, 3.0)], **words, **_CURVED,
            )
            if port.reverses:
                yield at_input(
                    port, two_slopes, parameters=[Coefficient("asymmetry", "", -0.95, 0.95, 0.02, linear=True)], starts=[(0.0,)], notes=_shape("two slopes"),
                    predicts="even distortion in proportion to the level", refuted_by="the same answer to both signs of the input", **words,
                )
            span = 1 / machine.bandwidth
            yield at_input(
                port, thrust, memory=1, unsettled=1, substeps=4, parameters=[level, Coefficient("time constant", "s", 1e-3 * span, 300 * span, 0.05 * span)],
                starts=[(r * port.rms, s * span) for r in (0.3, 1.0, 3.0) for s in (0.3, 3.0)], notes=_shape("thrust of a rotor"), **words,
                predicts="a gain that grows with the level and a lag that does not depend on it", refuted_by="a gain that is the same at every level",
            )
        for store in store_states(machine):
            yield from _flows(store, machine, words)
        if machine.axes or machine.plant is None:
            return
        for port in machine.states:
            rate = max(abs(float(machine.plant.A[port.index, port.index])), 1e-3 * machine.bandwidth)
            law, _, parameters, starts = next(iter(_polynomials(port, "1/s", rate)))
            yield at_state(port, law, [state(port)], parameters=parameters, starts=starts, description=True, **words, **_POLYNOMIAL)
            if not port.reverses:
                yield at_state(port, curve_about, [state(port)], description=True, **_about(port, "1/s", rate), **words, **_POLYNOMIAL)


def _shape(name: str) -> dict[str, str]:
    return {"variant": name, "of": ""} if name else {}


def _level(port: Size) -> Coefficient:
    return Coefficient("level", port.unit, 0.02 * port.rms, 50 * port.peak, 0.1 * port.rms)


Form = tuple[Law, str, Sequence[Coefficient], Sequence[Sequence[float]]]


def _polynomials(port: Size, unit: str, scale: float) -> Iterable[Form]:
    """Yield law, variant, parameters and starts: square and cube together first, then one power at a time."""
    def share(name: str, free: bool = True) -> Coefficient:
        return Coefficient(name, unit, -20 * scale, 20 * scale, 0.05 * scale, linear=True) if free else constant(name, unit, 0.0)

    r = port.rms
    reference = constant("reference", port.unit, r)
    for name, square, cube in (("", True, True), ("square", True, False), ("cube", False, True)):
        yield _curve, name, [share("quadratic share", square), share("cubic share", cube), reference], [(0.0, 0.0, r)]
    yield signed_square, "signed square", [share("quadratic share"), reference], [(0.0, r)]


def _about(port: Size, unit: str, scale: float) -> dict[str, Any]:
    """Return parameters, starts and variant of `curve_about` for a signal of one sign."""
    _, _, parameters, starts = next(iter(_polynomials(port, unit, scale)))
    shift = Coefficient("shift", f"{port.unit}/s" if unit else port.unit, -2 * scale * port.peak, 2 * scale * port.peak, 0.1 * scale * port.rms, linear=True, nuisance=True)
    return {"parameters": [*parameters, operating_point(port), shift], "starts": [(*starts[0], port.mean, 0.0)], "notes": _shape("about the operating point")}


def _flows(store: Size, machine: Machine, words: dict[str, Any]) -> Iterable[Hypothesis]:
    """Yield flows out of a store that go with a power of its level, from zero and about an operating point."""
    assert machine.plant is not None  # noqa: S101
    ways = downstream(machine, store)
    rate = float(-machine.plant.A[store.index, store.index])
    fixed = [constant("model's rate", "1/s", rate), *(constant("per unit lost", "", v) for _, v in ways)]
    writes = [state(store), *(Signal("x", i) for i, _ in ways)]
    top = store.peak
    for law, name, low, levels in ((outflow, "outflow", 0.02 * top, (0.3, 1.0)), (outflow_about, "outflow about a level", 0.5 * top, (1.0, 3.0))):
        yield at_state(
            store, law, [state(store)], writes, notes=_shape(name),
            parameters=[Coefficient("exponent", "", 0.2, 3.0, 0.05), Coefficient("level", store.unit, low, 50 * top, 0.1 * top), *fixed],
            starts=[(n, s * top, *(c.low for c in fixed)) for n in (0.5, 1.5) for s in levels], **words,
            predicts="a time constant that depends on the level", refuted_by="the same time constant when nearly empty and when full",
        )
