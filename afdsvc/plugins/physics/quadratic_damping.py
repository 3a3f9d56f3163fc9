"""Quadratic damping: drag that grows with the square of the speed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_force, force, operating_point, unknown_force, velocity
from afdsvc.plugins.physics.joint import at_joint, joints


def drag(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-c v |v|``."""
    out[0] -= p[0] * z[0] * abs(z[0])


def _in_place(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """`drag` less its tangent at an operating point w, which the model has, and a constant, ``p = (c, w, constant)``."""
    out[0] -= p[0] * (z[0] * abs(z[0]) - abs(p[1]) * (2 * z[0] - p[1])) + p[2]


def _joint(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """`drag` of a relative velocity ``v_1 + s_2 v_2``; the second mass takes ``s_2 r_2`` of it, ``p = (c, s_2, r_2)``."""
    rate = z[0] + p[1] * z[1]
    push = p[0] * rate * abs(rate)
    out[0] -= push
    out[1] -= p[1] * p[2] * push


class QuadraticDamping:
    """Turbulent drag on every axis of motion, and of a damper beside every spring between two masses."""

    name = "quadratic_damping"
    summary = "drag that grows with the square of the speed"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis, two where it turns one way, and one per spring."""
        words: dict[str, Any] = {
            "physics": self.name, "family": "damping", "predicts": "damping that grows with the amplitude; odd distortion in phase with the velocity",
            "refuted_by": "damping that is the same at every level",
        }
        for axis in machine.axes:
            yield at_force(axis, drag, [velocity(axis)], parameters=[_size(axis)], starts=[(0.0,)], **words)
            if not axis.rate.reverses:
                yield at_force(
                    axis, _in_place, [velocity(axis)], parameters=[_size(axis), operating_point(axis.rate), unknown_force(axis)],
                    starts=[(0.0, axis.rate.mean, 0.0)], notes={"variant": "in place of a line", "of": ""}, **words,
                )
        for k in [k for k in joints(machine) if k.stiffness > 0]:
            yield at_joint(k, _joint, [_size(k.axes[0])], [(0.0,)], rates=True, **words)


def _size(axis: Axis) -> Coefficient:
    scale = 0.1 * axis.push / axis.rate.rms**2
    return force(axis, "drag", 0.0, 200 * scale, scale, f"({axis.rate.unit})^2", linear=True)
