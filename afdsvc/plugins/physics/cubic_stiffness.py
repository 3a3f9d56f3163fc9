"""Cubic stiffness: a spring that hardens (or softens) with the square of the deflection."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal
from afdsvc.plugins.physics.attach import at_force, at_input, constant, force, placed, state
from afdsvc.plugins.physics.joint import at_joint, joints, spring


def _cubic(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-k3 q^3``."""
    out[0] -= p[0] * z[0] ** 3


def _about(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-k3 ((q - c)^3 - (q0 - c)^3)``: a load holds the spring at q0, elsewhere than at the middle of its characteristic, ``p = (k3, c, q0)``."""
    out[0] -= p[0] * ((z[0] - p[1]) ** 3 - (p[2] - p[1]) ** 3)


def _fed_back(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-k3 y^3`` at the input, for a machine whose states have no names."""
    out[0] -= p[0] * z[1] ** 3


class CubicStiffness:
    """A hardening spring on every axis and in joints between axes; fed back from the output to the input where no axis is known."""

    name = "cubic_stiffness"
    summary = "a spring force with a part proportional to the cube of the deflection"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return two hypotheses per axis and one per joint, or one for a machine of one input and one output without axes."""
        words: dict[str, Any] = {
            "physics": self.name, "family": "stiffness",
            "predicts": "odd distortion that grows with the cube of the amplitude; a resonance that moves with the level",
            "refuted_by": "distortion at even lines, or a resonance that stays where it is",
        }
        for axis, q in placed(machine):
            scale = 0.05 * axis.push / q.rms**3
            k3 = force(axis, "stiffness", -200 * scale, 200 * scale, scale, f"({q.unit})^3", linear=True)
            yield at_force(axis, _cubic, [state(q)], parameters=[k3], starts=[(0.0,)], **words)
            held = 0.0 if q.reverses else q.mean
            centre = Coefficient("centre", q.unit, held - 3 * q.rms, held + 3 * q.rms, 0.1 * q.rms)
            yield at_force(
                axis, _about, [state(q)], parameters=[k3, centre, constant("held at", q.unit, held)],
                starts=[(0.0, held + side * 0.3 * q.rms, held) for side in (-1, 1)],
                notes={"variant": "about another centre", "of": ""}, **words,
            )
        for joint in joints(machine):
            a, q = joint.axes[0], joint.deflection
            scale = 0.05 * a.push / q.rms**3
            k3 = force(a, "stiffness", -200 * scale, 200 * scale, scale, f"({q.unit})^3", linear=True)
            yield at_joint(joint, spring, [k3, constant("power", "", 3.0)], [(0.0, 3.0)], **words)
        if not machine.axes and len(machine.inputs) == len(machine.outputs) == 1:
            u, y = machine.inputs[0], machine.outputs[0]
            scale = 0.05 * u.rms / y.rms**3
            k3 = Coefficient("stiffness", f"{u.unit}/({y.unit})^3", -200 * scale, 200 * scale, scale, linear=True)
            yield at_input(u, _fed_back, [Signal("y", y.index)], parameters=[k3], starts=[(0.0,)], **words)
