"""Stribeck friction: more force at very low speed than at higher speed."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_force, force, motion, velocity


def _stribeck(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-(Fc + Fb exp(-(v / vs)^2)) tanh(v / w)``: Fc at speed, Fc + Fb at standstill."""
    size = p[0] + p[1] * math.exp(-((z[0] / p[2]) ** 2))
    out[0] -= size * math.tanh(z[0] / (p[3] + size * dt))


def presliding(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """LuGre: bristles of stiffness ``sigma0 = (Fc + Fb) / way`` and deflection ``d' = v - sigma0 |v| d / F(v)``; ``-sigma0 d - sigma1 d'``.

    Canudas de Wit et al. (1995), eq. 4 to 6, exact for a velocity held over the step; with ``Fb = 0`` it is Dahl's and depends on the
    way alone. Bristles are never stiffer than one step can follow.
    """
    most = p[0] + p[1]
    if most > 0.0:
        stiff = most / (p[3] + 4.0 * most * dt * dt)
        full = math.copysign((p[0] + p[1] * math.exp(-((z[0] / p[2]) ** 2))) / stiff, z[0])
        before = m[0]
        m[0] = full + (before - full) * (math.exp(-z[0] * dt / full) if full != 0.0 else 0.0)
        out[0] -= stiff * m[0] + 2.0 * p[4] * math.sqrt(stiff) * (m[0] - before) / dt


def bristle(axis: Axis, machine: Machine) -> Coefficient:
    """Return the deflection at which bristles slide, in the unit of the axis' motion."""
    reach = axis.position.rms if axis.position else axis.rate.rms / machine.bandwidth
    return Coefficient("presliding deflection", motion(axis), 1e-5 * reach, 0.5 * reach, 0.01 * reach)


class StribeckFriction:
    """Dry friction with a breakaway force on every axis of motion."""

    name = "stribeck_friction"
    summary = "dry friction that falls from a breakaway force as the speed rises"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return two hypotheses per axis, without and with a spring before sliding."""
        words: dict[str, Any] = {
            "physics": self.name, "family": "friction",
            "predicts": "a force that is largest just after the velocity changes sign and falls with speed",
            "refuted_by": "a friction force that stays the same from creeping to full speed",
        }
        for axis in machine.axes:
            v, push, way = axis.rate.rms, axis.push, bristle(axis, machine)
            common = [
                force(axis, "force", 0.0, 20 * push, 0.1 * push, linear=True), force(axis, "breakaway excess", 0.0, 20 * push, 0.1 * push, linear=True),
                Coefficient("stribeck speed", axis.rate.unit, 1e-2 * v, 3 * v, 0.1 * v),
            ]
            yield at_force(
                axis, _stribeck, [velocity(axis)], parameters=[*common, Coefficient("rounding", axis.rate.unit, 1e-4 * v, 0.3 * v, 0.02 * v, nuisance=True)],
                starts=[(0.0, 0.0, 0.1 * v, 0.01 * v), (0.0, 0.0, 0.4 * v, 0.02 * v), (0.0, 0.0, 1.0 * v, 0.1 * v)], **words,
            )
            yield at_force(
                axis, presliding, [velocity(axis)], memory=1, notes={"variant": "presliding", "of": ""},
                parameters=[*common, way, Coefficient("damping ratio", "", 0.1, 1.0, 0.1, nuisance=True)],
                starts=[(0.0, 0.0, s * v, w * way.high, 0.5) for s in (0.1, 0.4) for w in (0.01, 0.2)], **words,
            )
