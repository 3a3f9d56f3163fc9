"""Asymmetric damping: another damping in each direction, as in a shock absorber."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_force, force, velocity
from afdsvc.plugins.physics.joint import at_joint, joints


def _damper(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-c1 v`` forwards and ``-c2 v`` backwards."""
    out[0] -= (p[0] if z[0] > 0 else p[1]) * z[0]


def _joint(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """`_damper` of a relative velocity ``v_1 + s_2 v_2``; the second mass takes ``s_2 r_2`` of it, ``p = (c1, c2, s_2, r_2)``."""
    rate = z[0] + p[2] * z[1]
    push = (p[0] if rate > 0 else p[1]) * rate
    out[0] -= push
    out[1] -= p[2] * p[3] * push


class AsymmetricDamping:
    """A damper with two coefficients on every axis of motion and beside every spring between two masses, beside the model's own damping."""

    name = "asymmetric_damping"
    summary = "damping that differs between the two directions of motion"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis that moves both ways and per spring; each direction may lose what damping the model has, and no more."""
        words: dict[str, Any] = {
            "physics": self.name, "family": "damping", "predicts": "even distortion in proportion to the level, and a mean that shifts with the speed",
            "refuted_by": "a residual that is the same in both directions of motion",
        }
        for axis in [a for a in machine.axes if a.rate.reverses]:
            i = axis.rate.index
            own = 0.0 if machine.plant is None else max(-float(machine.plant.A[i, i]), 0.0)
            yield at_force(axis, _damper, [velocity(axis)], starts=[(0.0, 0.0)], parameters=_both(axis, own), **words)
        for k in [k for k in joints(machine) if k.stiffness > 0]:
            yield at_joint(k, _joint, _both(k.axes[0], k.damping), [(0.0, 0.0)], rates=True, **words)


def _both(axis: Axis, own: float) -> list[Coefficient]:
    scale = 0.1 * axis.push / axis.rate.rms
    return [force(axis, f"damping {way}", -own, max(200 * scale, own), scale, axis.rate.unit, linear=True) for way in ("forwards", "backwards")]
