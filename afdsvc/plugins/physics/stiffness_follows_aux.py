"""A stiffness that follows an auxiliary signal, such as speed or supply pressure."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal
from afdsvc.plugins.physics.attach import at_force, force, position
from afdsvc.plugins.physics.gain_follows_aux import varying


def spring(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-c (aux - mean) q``."""
    out[0] -= p[0] * (z[1] - p[1]) * z[0]


class StiffnessFollowsAux:
    """A spring whose stiffness depends on an auxiliary signal, for every axis and signal."""

    name = "stiffness_follows_aux"
    summary = "a stiffness that follows a measured auxiliary signal"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis and varying auxiliary signal."""
        for axis in machine.axes:
            for aux in varying(machine):
                scale = 0.05 * axis.push / axis.position.rms / aux.rms
                per = f"{axis.position.unit}/({aux.unit or aux.name})"
                yield at_force(
                    axis, spring, [position(axis), Signal("aux", aux.index)], physics=self.name, family="follows aux",
                    parameters=[
                        force(axis, f"stiffness per {aux.name}", -100 * scale, 100 * scale, scale, per, linear=True),
                        Coefficient("reference", aux.unit, aux.mean, aux.mean, 1.0, nuisance=True),
                    ],
                    starts=[(0.0, aux.mean)], notes={"variant": aux.name},
                    predicts=f"a resonance that moves with {aux.name}",
                    refuted_by=f"a resonance that stays where it is while {aux.name} varies",
                )
