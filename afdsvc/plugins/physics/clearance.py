"""Clearance: a stop, or a second spring, that is met only beyond a gap."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Machine, Signal, Size
from afdsvc.plugins.physics.attach import at_force, at_output, constant, force, imposed, placed, state, velocity
from afdsvc.plugins.physics.joint import at_joint, joints

PLAY = "play in the spring"
_SLACK: dict[str, Any] = {
    "physics": "clearance", "family": "stiffness", "predicts": "a resonance that rises with the level, and motion without a force around the middle",
    "refuted_by": "a stiffness that is the same for small motion as for large",
}


def _stop(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-k (|q| - g)`` towards the middle once ``|q| > g``."""
    over = abs(z[0]) - p[1]
    if over > 0:
        out[0] -= p[0] * math.copysign(over, z[0])


def _side(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-k (q - g)`` beyond ``g`` on one side, ``p[2]``: 1 above, -1 below."""
    out[0] -= p[0] * p[2] * max(p[2] * (z[0] - p[1]), 0.0)


def bumped(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``+k (u - g)`` beyond ``g`` on one side, ``p[2]``: the force of a stop against which a motion ``u`` is imposed."""
    out[0] += p[0] * p[2] * max(p[2] * (z[1] - p[1]), 0.0)


def _joint(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """`_stop` of a deflection ``q_1 + s_2 q_2 + ...``; axis k takes ``s_k r_k`` of it (see `Joint`), ``p[2:] = s_2, ..., r_2, ...``."""
    n, deflection = len(out), z[0]
    for k in range(1, n):
        deflection += p[1 + k] * z[k]
    push = p[0] * math.copysign(max(abs(deflection) - p[1], 0.0), deflection)
    out[0] -= push
    for k in range(1, n):
        out[k] -= (p[1 + k] or -1.0) * p[n + k] * push


def _play(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The model's spring of stiffness ``p[0]`` acts beyond the gap only: what it does below is taken away."""
    out[0] += p[0] * min(max(z[0], -p[1]), p[1])


def _joint_play(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """`_play` in a joint of two masses, whose damper, ``p[2]`` of its spring, acts beyond the gap only, too; ``p[3:] = s_2, r_2``."""
    deflection = z[0] + p[3] * z[1]
    push = p[0] * min(max(deflection, -p[1]), p[1])
    if abs(deflection) < p[1]:
        push += p[0] * p[2] * (z[2] - z[3])
    out[0] += push
    out[1] -= p[4] * push


class Clearance:
    """A spring behind a gap, on both sides or one, on every axis of motion and in joints between axes, on one side where a motion is imposed, and play in
    the springs of the model."""

    name = "clearance"
    summary = "a spring force that begins only beyond a gap"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return hypotheses per axis, per joint and per imposed motion, started at gaps between a third and nearly all of the travel."""
        yield from _imposed(machine)
        for axis, q in placed(machine):
            peak = q.peak
            scale = 0.1 * axis.push / q.rms
            yield at_force(
                axis, _stop, [state(q)], physics=self.name, family="stiffness",
                parameters=[
                    force(axis, "stiffness", 0.0, 1e4 * scale, scale, q.unit, linear=True),
                    Coefficient("gap", q.unit, 0.02 * peak, 0.98 * peak, 0.02 * peak),
                ],
                starts=[(0.0, share * peak) for share in (0.15, 0.35, 0.6, 0.8)],
                predicts="nothing below a level, and above it a stiffness that sets in at the same deflection everywhere",
                refuted_by="distortion at levels that never reach the gap",
            )
            for side, word in ((1.0, "above"), (-1.0, "below")):
                stiffness = force(axis, "stiffness", 0.0, 1e4 * scale, scale, q.unit, linear=True)
                yield at_force(axis, _side, [state(q)], notes={"variant": f"stop {word}", "of": ""}, **_one_sided(stiffness, q, side, word))
            own = 0.0 if machine.plant is None else -float(machine.plant.A[axis.rate.index, q.index])
            if own > 0:
                yield at_force(axis, _play, [state(q)], notes={"variant": PLAY, "of": ""}, parameters=_lost(axis, q, own), starts=_gaps(q, own), **_SLACK)
        for k in joints(machine):
            a, q = k.axes[0], k.deflection
            scale = 0.1 * a.push / q.rms
            yield at_joint(
                k, _joint, [
                    force(a, "stiffness", -200 * scale, 1e3 * scale, scale, q.unit, linear=True),
                    Coefficient("gap", q.unit, 0.02 * q.peak, 2 * q.peak, 0.02 * q.peak),
                ],
                [(0.0, share * q.peak) for share in (0.1, 0.3, 0.6)], physics=self.name, family="stiffness",
                predicts="modes that change their frequency together beyond a level", refuted_by="modes that stay where they are at every level",
            )
            if k.stiffness > 0:
                damper = constant("damping over stiffness", "s", k.damping / k.stiffness)
                starts = [(*s, damper.low) for s in _gaps(q, k.stiffness)]
                yield at_joint(k, _joint_play, [*_lost(a, q, k.stiffness), damper], starts, further=[velocity(x) for x in k.axes], what=PLAY, **_SLACK)


def _one_sided(stiffness: Coefficient, q: Size, side: float, word: str) -> dict[str, Any]:
    """Return what a stop on one side of a way has: its numbers, where they begin, and the words."""
    return {
        "physics": "clearance", "family": "stiffness",
        "parameters": [stiffness, Coefficient("place", q.unit, q.mean - q.reach, q.mean + q.reach, 0.02 * q.reach), constant("side", "", side)],
        "starts": [(0.0, q.mean + side * share * q.reach, side) for share in (0.0, 0.15, 0.35, 0.6, 0.8)],
        "predicts": f"a stiffness that sets in {word} a place and nothing on the other side of it", "refuted_by": "distortion alike on both sides",
    }


def _imposed(machine: Machine) -> Iterable[Hypothesis]:
    """Yield stops on one side of every imposed motion, in the force that answers it."""
    for port, u, low, high in (*imposed(machine, "length"), *imposed(machine, "angle")):
        size = port.rms / u.rms
        stiffness = Coefficient("stiffness", f"{port.unit}/{u.unit}", 1e3 * low * size, 1e3 * high * size, 0.1 * size, linear=True)
        for side, word in ((1.0, "above"), (-1.0, "below")):
            notes = {"variant": f"{u.name}, stop {word}", "of": u.name}
            yield at_output(port, bumped, [Signal("u", u.index)], notes=notes, **_one_sided(stiffness, u, side, word))


def _lost(axis: Axis, q: Size, stiffness: float) -> list[Coefficient]:
    return [
        force(axis, "stiffness", 0.0, 2 * stiffness, 0.1 * stiffness, q.unit, linear=True),
        Coefficient("gap", q.unit, 0.02 * q.rms, 3 * q.peak, 0.02 * q.peak),
    ]


def _gaps(q: Size, stiffness: float) -> list[tuple[float, float]]:
    """Return starts; with play a deflection is larger than the model's."""
    return [(stiffness, share * q.peak) for share in (0.1, 0.3, 0.6, 1.0, 1.7, 2.8)]
