"""Coulomb friction: a force against the direction of motion whose size does not depend on the speed."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Machine, Signal, Size
from afdsvc.plugins.physics.attach import at_force, at_output, constant, converter, force, imposed, placed, state, velocity
from afdsvc.plugins.physics.joint import Joint, at_joint, joints
from afdsvc.plugins.physics.stribeck_friction import bristle, presliding

_WORDS: dict[str, Any] = {"physics": "coulomb_friction", "family": "friction"}
_JUMP: dict[str, Any] = {
    "predicts": "a jump of the force where the velocity changes sign; its share falls as the amplitude grows",
    "refuted_by": "a residual that does not depend on the sign of the velocity",
}


def coulomb_force(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-F tanh(v / w)``, the rounding ``w`` never narrower than one step can follow."""
    out[0] -= p[0] * math.tanh(z[0] / (p[1] + p[0] * dt))


def asymmetric(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """`coulomb_force` with a force of its own for each direction: while it moves, even friction of their mean and a load of half their difference."""
    size = p[0] if z[0] > 0 else p[1]
    out[0] -= size * math.tanh(z[0] / (p[2] + size * dt))


def loaded(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """`coulomb_force` of ``F + c |load|``; the load is a sum of the signals behind the velocity, coefficients ``p[3:]``."""
    load = 0.0
    for k in range(1, len(z)):
        load += p[2 + k] * z[k]
    size = p[0] + p[1] * abs(load)
    out[0] -= size * math.tanh(z[0] / (p[2] + size * dt))


def along(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """`coulomb_force` of ``F + a d + b d^2`` where that is positive; ``d = (q - mean) / rms`` is the place."""
    d = (z[1] - p[4]) / p[5]
    size = max(p[0] + p[1] * d + p[2] * d * d, 0.0)
    out[0] -= size * math.tanh(z[0] / (p[3] + size * dt))


def _joint(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """`coulomb_force` of a relative velocity ``v_1 + s_2 v_2 + ...``; axis k takes ``s_k`` times ``r_k`` of it, ``p[2:] = s_2, ..., r_2, ...``."""
    n, rate, felt = len(out), z[0], 1.0
    for k in range(1, n):
        rate += p[1 + k] * z[k]
        felt += p[1 + k] ** 2 * p[n + k]
    push = p[0] * math.tanh(rate / (p[1] + p[0] * felt * dt))
    out[0] -= push
    for k in range(1, n):
        out[k] -= p[1 + k] * p[n + k] * push


def slip(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """A spring of the model that slips: ``+k`` times what its deflection ``q_1 + s_2 q_2 + ...`` has gone beyond ``width``."""
    n, deflection = len(out), z[0]
    for k in range(1, n):
        deflection += p[1 + k] * z[k]
    m[0] = min(max(m[0], deflection - p[1]), deflection + p[1])
    out[0] += p[0] * m[0]
    for k in range(1, n):
        out[k] += (p[1 + k] or -1.0) * p[n + k] * p[0] * m[0]


def jenkins(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """A spring beside the model's that slips beyond ``width``: ``-k`` times the part of its deflection that does not slip (G. M. Jenkins 1962; bolted joints)."""
    n, deflection = len(out), z[0]
    for k in range(1, n):
        deflection += p[1 + k] * z[k]
    m[0] = min(max(m[0], deflection - p[1]), deflection + p[1])
    push = p[0] * (deflection - m[0])
    out[0] -= push
    for k in range(1, n):
        out[k] -= (p[1 + k] or -1.0) * p[n + k] * push


def reaction(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``+F tanh(u / w)``: the force of a friction element whose velocity ``u`` is imposed."""
    out[0] += p[0] * math.tanh(z[1] / p[1])


class CoulombFriction:
    """Dry friction on every axis of motion, between axes, and where a motion is imposed."""

    name = "coulomb_friction"
    summary = "a force of constant size against the direction of motion"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return several hypotheses per axis, two per pair of axes that may rub, one per force that answers an imposed velocity."""
        for axis in machine.axes:
            yield from _on(axis, machine)
        for axis, q in placed(machine):
            yield _along(axis, q)
        for k in joints(machine):
            yield from _between(k)
        for port, u, low, high in imposed(machine, "velocity"):
            r, f = u.rms, port.rms
            yield at_output(
                port, reaction, [Signal("u", u.index)], parameters=[
                    Coefficient("force", port.unit, 10 * low * f, 10 * high * f, 0.1 * f, linear=True),
                    Coefficient("rounding", u.unit, 1e-3 * r, 2 * r, 0.05 * r),
                ],
                starts=[(0.0, w * r) for w in (0.02, 0.1, 0.5)], **_WORDS, **_JUMP, notes={"variant": u.name},
            )


def rounding(rate: Size) -> Coefficient:
    """Return the velocity over which a jump is rounded."""
    return Coefficient("rounding", rate.unit, 1e-4 * rate.rms, 0.7 * rate.rms, 0.02 * rate.rms, nuisance=True)


def _on(axis: Axis, machine: Machine) -> Iterable[Hypothesis]:
    v, width = axis.rate.rms, rounding(axis.rate)
    size = force(axis, "force", 0.0, 20 * axis.push, 0.1 * axis.push, linear=True)
    yield at_force(axis, coulomb_force, [velocity(axis)], parameters=[size, width], starts=[(0.0, 0.02 * v), (0.0, 0.2 * v)], **_WORDS, **_JUMP)
    both = [force(axis, n, 0.0, 20 * axis.push, 0.1 * axis.push, linear=True) for n in ("force forwards", "force backwards")]
    yield at_force(
        axis, asymmetric, [velocity(axis)], parameters=[*both, width], starts=[(0.0, 0.0, 0.02 * v), (0.0, 0.0, 0.2 * v)],
        notes={"variant": "asymmetric", "of": ""}, **_WORDS, predicts="jumps of the force where the velocity changes sign, and a mean force; moving, it is even friction beside a constant load",
        refuted_by="a residual that does not depend on the sign of the velocity",
    )
    way = bristle(axis, machine)
    yield at_force(
        axis, presliding, [velocity(axis)], memory=1, notes={"variant": "presliding", "of": ""},
        parameters=[
            size, constant("breakaway excess", "", 0.0), constant("stribeck speed", axis.rate.unit, v),
            way, constant("damping ratio", "", 0.5),
        ],
        starts=[(0.0, 0.0, v, s * way.high, 0.5) for s in (0.01, 0.1, 0.5)], **_WORDS,
        predicts="a spring for small motion and a constant force beyond it, the same at every frequency",
        refuted_by="a force that has its full size at once where the velocity changes sign",
    )
    for what, signals, terms in _loads(axis, machine):
        share = Coefficient(f"share of {what}", "", 0.0, 3.0, 0.05, linear=True)
        yield at_force(
            axis, loaded, [velocity(axis), *signals], parameters=[size, share, width, *terms],
            starts=[(0.0, 0.0, 0.02 * v, *(c.low for c in terms))], notes={"variant": f"grows with {what}", "of": ""}, **_WORDS,
            predicts=f"a jump of the force where the velocity changes sign, as large as {what}",
            refuted_by="a jump that is the same under every load",
        )


def _loads(axis: Axis, machine: Machine) -> Iterable[tuple[str, list[Any], list[Coefficient]]]:
    """Yield what may press the surfaces together: the force of the input, or of the state that drives the axis in its place, and what is passed
    on between it and spring or weight."""
    if axis.input is not None:
        name, drive, gain = "the input", [Signal("u", axis.input)], axis.gain
    elif machine.plant is not None and (source := converter(machine, axis)):
        name, drive, gain = source.name, [state(source)], float(machine.plant.A[axis.rate.index, source.index])
    else:
        return
    yield name, drive, [constant("gain", "", gain)]
    if machine.plant is None:
        return
    row = machine.plant.A[axis.rate.index]
    held = [q for _, q in placed(machine) if row[q.index]]
    if held:
        yield "the transmitted force", [*drive, *(state(q) for q in held)], [
            constant("gain", "", gain), *(constant("nominal", "", -float(row[q.index])) for q in held),
        ]


def _between(k: Joint) -> Iterable[Hypothesis]:
    """Yield friction and slip in a joint of several coordinates: of the spring the model has, or of one beside it between two masses."""
    a, q, r = k.axes[0], k.deflection, k.axes[0].rate.rms
    size = force(a, "force", 0.0, 20 * a.push, 0.1 * a.push, linear=True)
    yield at_joint(k, _joint, [size, rounding(a.rate)], [(0.0, 0.02 * r)], rates=True, **_WORDS, **_JUMP)
    width = Coefficient("width", q.unit, 1e-3 * q.rms, 3 * q.peak, 0.05 * q.rms)
    springs = [("stiffness lost", slip, "slip"), ("stiffness", jenkins, "a spring that slips")]
    for name, law, what in springs if k.stiffness > 0 else springs[:1]:
        stiff = force(a, name, 0.0, 20 * a.push / q.rms, 0.05 * a.push / q.rms, q.unit, linear=True)
        yield at_joint(
            k, law, [stiff, width], [(0.0, 0.2 * q.rms), (0.0, 0.8 * q.rms)], what=what, memory=1, **_WORDS,
            predicts="a mode that falls in frequency and gains damping beyond a level", refuted_by="a mode that stays where it is at every level",
        )


def _along(axis: Axis, q: Size) -> Hypothesis:
    push, v = axis.push, axis.rate.rms
    bends = [force(axis, n, -20 * push, 20 * push, 0.1 * push, linear=True) for n in ("rise along the way", "bend along the way")]
    return at_force(
        axis, along, [velocity(axis), state(q)],
        parameters=[
            force(axis, "force", 0.0, 20 * push, 0.1 * push, linear=True), *bends, rounding(axis.rate),
            constant("middle", q.unit, q.mean), constant("unit of way", q.unit, q.rms),
        ],
        starts=[(0.0, 0.0, 0.0, 0.02 * v, q.mean, q.rms)], notes={"variant": "along the way", "of": ""}, **_WORDS,
        predicts="a jump of the force where the velocity changes sign, of another size at another place",
        refuted_by="a jump that is the same at every place",
    )
