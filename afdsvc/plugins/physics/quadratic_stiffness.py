"""Quadratic stiffness: a spring that is stiffer to one side than to the other."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal
from afdsvc.plugins.physics.attach import at_force, at_input, constant, force, operating_point, placed, state, unknown_force
from afdsvc.plugins.physics.joint import at_joint, joints, spring


def _quadratic(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-k2 q^2``."""
    out[0] -= p[0] * z[0] ** 2


def _about(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """`_quadratic` of the deviation from an operating point, and a constant, ``p = (k2, operating point, constant)``."""
    out[0] -= p[0] * (z[0] - p[1]) ** 2 + p[2]


def _fed_back(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-k2 y^2`` at the input, for a machine whose states have no names."""
    out[0] -= p[0] * z[1] ** 2


class QuadraticStiffness:
    """An asymmetric spring on every axis and in joints between axes; fed back from the output to the input where no axis is known."""

    name = "quadratic_stiffness"
    summary = "a spring force with a part proportional to the square of the deflection"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis, two where its position has one sign, and one per joint, or one for a machine of one input and one output without axes."""
        words: dict[str, Any] = {
            "physics": self.name, "family": "stiffness",
            "predicts": "even distortion and a mean that shifts with the square of the amplitude",
            "refuted_by": "distortion at odd lines only",
        }
        for axis, q in placed(machine):
            scale = 0.05 * axis.push / q.rms**2
            k2 = force(axis, "stiffness", -200 * scale, 200 * scale, scale, f"({q.unit})^2", linear=True)
            yield at_force(axis, _quadratic, [state(q)], parameters=[k2], starts=[(0.0,)], **words)
            if not q.reverses:
                yield at_force(
                    axis, _about, [state(q)], parameters=[k2, operating_point(q), unknown_force(axis)], starts=[(0.0, q.mean, 0.0)],
                    notes={"variant": "about the operating point", "of": ""}, **words,
                )
        for joint in joints(machine):
            a, q = joint.axes[0], joint.deflection
            scale = 0.05 * a.push / q.rms**2
            k2 = force(a, "stiffness", -200 * scale, 200 * scale, scale, f"({q.unit})^2", linear=True)
            yield at_joint(joint, spring, [k2, constant("power", "", 2.0)], [(0.0, 2.0)], **words)
        if not machine.axes and len(machine.inputs) == len(machine.outputs) == 1:
            u, y = machine.inputs[0], machine.outputs[0]
            scale = 0.05 * u.rms / y.rms**2
            k2 = Coefficient("stiffness", f"{u.unit}/({y.unit})^2", -200 * scale, 200 * scale, scale, linear=True)
            yield at_input(u, _fed_back, [Signal("y", y.index)], parameters=[k2], starts=[(0.0,)], **words)
