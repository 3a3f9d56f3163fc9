"""A stiffness that follows an auxiliary signal, such as speed or supply pressure."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Machine, Signal, Size
from afdsvc.plugins.physics.attach import at_force, force, on_machine, position, velocity
from afdsvc.plugins.physics.gain_follows_aux import curvature, varying


def spring(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-(c + b d) d q`` with ``d = aux - mean``."""
    d = z[1] - p[1]
    out[0] -= (p[0] + p[2] * d) * d * z[0]


def springs(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-c_k (1 + b d) d q_k`` on every axis k, ``d = aux - mean``: one cause, felt in all directions."""
    n = len(out)
    d = z[n] - p[n]
    for k in range(n):
        out[k] -= p[k] * (1 + p[n + 1] * d) * d * z[k]


class StiffnessFollowsAux:
    """A spring whose stiffness depends on an auxiliary signal, for every axis and signal, and for all axes at once."""

    name = "stiffness_follows_aux"
    summary = "a stiffness that follows a measured auxiliary signal"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis and varying auxiliary signal, and per signal one for all axes."""
        for aux in varying(machine) if len(machine.axes) > 1 else ():
            yield self._everywhere(machine, aux)
        for axis in machine.axes:
            for aux in varying(machine):
                yield at_force(
                    axis, spring, [position(axis), Signal("aux", aux.index)], physics=self.name, family="follows aux",
                    parameters=[
                        _share(axis, aux),
                        Coefficient("reference", aux.unit, aux.mean, aux.mean, 1.0, nuisance=True),
                        curvature(aux, "", _share(axis, aux).scale),
                    ],
                    starts=[(0.0, aux.mean, 0.0)], notes={"variant": aux.name},
                    predicts=f"a resonance that moves with {aux.name}",
                    refuted_by=f"a resonance that stays where it is while {aux.name} varies",
                )

    def _everywhere(self, machine: Machine, aux: Size) -> Hypothesis:
        shares = [_share(axis, aux, f" of {axis.name}") for axis in machine.axes]
        return on_machine(
            "force", springs, [*(position(a) for a in machine.axes), Signal("aux", aux.index)], [velocity(a) for a in machine.axes],
            physics=self.name, family="follows aux", starts=[(*np.zeros(len(shares)), aux.mean, 0.0)], notes={"variant": aux.name},
            parameters=[
                *shares, Coefficient("reference", aux.unit, aux.mean, aux.mean, 1.0, nuisance=True),
                Coefficient("curvature", "", -1 / aux.rms, 1 / aux.rms, 0.05 / aux.rms, nuisance=True),
            ],
            predicts=f"resonances of all directions that move together with {aux.name}",
            refuted_by=f"a resonance that stays where it is while {aux.name} varies",
        )


def _share(axis: Axis, aux: Size, where: str = "") -> Coefficient:
    scale = 0.05 * axis.push / axis.position.rms / aux.rms
    per = f"{axis.position.unit}/({aux.unit or aux.name})"
    return force(axis, f"stiffness per {aux.name}{where}", -100 * scale, 100 * scale, scale, per, linear=True)
