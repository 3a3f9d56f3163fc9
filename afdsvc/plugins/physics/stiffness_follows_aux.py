"""A stiffness that follows an auxiliary signal, such as speed or supply pressure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Machine, Signal, Size
from afdsvc.plugins.physics.attach import at_force, at_machine, force, placed, state, velocity
from afdsvc.plugins.physics.gain_follows_aux import curvature, varying


def _spring(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
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
        axes = list(placed(machine))
        for aux in varying(machine) if len(axes) > 1 else ():
            yield self._everywhere(axes, aux)
        for axis, q in axes:
            for aux in varying(machine):
                yield at_force(
                    axis, _spring, [state(q), Signal("aux", aux.index)], physics=self.name, family="follows aux",
                    parameters=[
                        _share(axis, q, aux),
                        Coefficient("reference", aux.unit, aux.mean, aux.mean, 1.0, nuisance=True),
                        curvature(aux, "", _share(axis, q, aux).scale),
                    ],
                    starts=[(0.0, aux.mean, 0.0)], notes={"variant": aux.name},
                    predicts=f"a resonance that moves with {aux.name}",
                    refuted_by=f"a resonance that stays where it is while {aux.name} varies",
                )

    def _everywhere(self, axes: Sequence[tuple[Axis, Size]], aux: Size) -> Hypothesis:
        shares = [_share(axis, q, aux, f" of {axis.name}") for axis, q in axes]
        return at_machine(
            "force", springs, [*(state(q) for _, q in axes), Signal("aux", aux.index)], [velocity(a) for a, _ in axes],
            physics=self.name, family="follows aux", starts=[(*np.zeros(len(shares)), aux.mean, 0.0)], notes={"variant": aux.name},
            parameters=[
                *shares, Coefficient("reference", aux.unit, aux.mean, aux.mean, 1.0, nuisance=True),
                Coefficient("curvature", "", -1 / aux.rms, 1 / aux.rms, 0.05 / aux.rms, nuisance=True),
            ],
            predicts=f"resonances of all directions that move together with {aux.name}",
            refuted_by=f"a resonance that stays where it is while {aux.name} varies",
        )


def _share(axis: Axis, q: Size, aux: Size, where: str = "") -> Coefficient:
    scale = 0.05 * axis.push / q.rms / aux.rms
    per = f"{q.unit}/({aux.unit or aux.name})"
    return force(axis, f"stiffness per {aux.name}{where}", -100 * scale, 100 * scale, scale, per, linear=True)
