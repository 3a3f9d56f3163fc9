"""Flexible mode: a resonance beside the modelled dynamics, driven by an input and seen at the outputs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.attach import on_machine


def mode(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``q'' + 2 zeta w q' + w^2 q = w^2 u``, seen as ``r_j q`` at output j; exact for an input held over the step."""
    w, zeta = p[0], p[1]
    decay, wd = math.exp(-zeta * w * dt), w * math.sqrt(max(1 - zeta * zeta, 1e-12))
    c, s = math.cos(wd * dt), math.sin(wd * dt)
    e, v = m[0] - z[0], m[1]
    m[0] = z[0] + decay * (e * c + (v + zeta * w * e) / wd * s)
    m[1] = decay * (v * c - (w * w * e + zeta * w * v) / wd * s)
    for j in range(len(out)):
        out[j] += p[2 + j] * m[0]


def _extend(plant: StateSpace, values: Sequence[float], column: int) -> StateSpace:
    w, zeta, shares = values[0], values[1], np.array(values[2:])
    n = plant.order
    A = np.block([[plant.A, np.zeros((n, 2))], [np.zeros((2, n)), np.array([[0.0, 1.0], [-w * w, -2 * zeta * w]])]])
    drive = np.zeros((2, plant.inputs))
    drive[1, column] = w * w
    C = np.hstack([plant.C, np.outer(shares, [1.0, 0.0])])
    return StateSpace(A, np.vstack([plant.B, drive]), C, plant.D)


class FlexibleMode:
    """A resonance the model does not have, one hypothesis per input that could drive it."""

    name = "flexible_mode"
    summary = "a resonance of the structure beside the modelled dynamics"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per input, started at the peaks of the residual and on a logarithmic grid."""
        low, high = 0.02 * machine.bandwidth, min(2 * machine.bandwidth, 0.9 * math.pi / machine.dt)
        grid = [*machine.peaks[:4], *np.geomspace(low * 3, high * 0.8, 5)]
        for port in machine.inputs:
            shares = [
                Coefficient(
                    f"share at {o.name}", f"{o.unit}/{port.unit}", -1e3 * r / port.rms, 1e3 * r / port.rms, r / port.rms, linear=True
                )
                for o, r in zip(machine.outputs, machine.residual, strict=True)
            ]
            yield on_machine(
                "output", mode, [Signal("u", port.index)], [Signal("y", o.index) for o in machine.outputs],
                physics=self.name, family="mode", memory=2,
                parameters=[
                    Coefficient("frequency", "rad/s", low, high, 0.02 * low), Coefficient("damping ratio", "", 1e-3, 0.9, 0.02), *shares
                ],
                starts=[(w, zeta, *np.zeros(len(shares))) for w in grid for zeta in (0.02, 0.15)],
                linear=lambda plant, values, column=port.index: _extend(plant, values, column),
                notes={"variant": port.name},
                predicts="a linear residual around one frequency, the same at every level",
                refuted_by="a residual that repeats at unexcited lines or changes its share with the level",
            )
