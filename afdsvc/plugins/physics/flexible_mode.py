"""Flexible mode: a resonance beside the modelled dynamics, driven by an input and seen at the outputs, or a mass on an axis."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.attach import at_force, on_machine, position, velocity

ATTACHED = "attached mass"
HARDENED = 0.88, 0.04, 0.003  # start on a hardening spring: of the peak's frequency, damping ratio, bend in units of the motion
DAMPED = 0.25  # damping ratio above which a structure has no resonance to speak of: its amplification is below two


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


def appendage(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """A mass ``p2`` (of the axis' own) on a spring and damper: ``s'' = -w^2 (s - q) - 2 zeta w (s' - v)``, pulling back ``p2 s''``.

    Exact for a motion of the axis that is straight over the step; the pull is its mean, so no momentum is lost.
    """
    if m[2] == 0.0:
        m[0], m[1], m[2] = z[0] - 0.5 * dt * z[1], z[1], 1.0
    w, zeta = p[0], p[1]
    decay, wd = math.exp(-zeta * w * dt), w * math.sqrt(max(1 - zeta * zeta, 1e-12))
    c, s = math.cos(wd * dt), math.sin(wd * dt)
    e, r, before = m[0] - (z[0] - 0.5 * dt * z[1]), m[1] - z[1], m[1]
    m[0] = z[0] + 0.5 * dt * z[1] + decay * (e * c + (r + zeta * w * e) / wd * s)
    m[1] = z[1] + decay * (r * c - (w * w * e + zeta * w * r) / wd * s)
    out[0] -= p[2] * (m[1] - before) / dt


def bent_appendage(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """`appendage` on a spring whose stiffness goes as ``1 + p3 (s - q)^2``, held over the step at what it is in its middle."""
    if m[2] == 0.0:
        m[0], m[1], m[2] = z[0] - 0.5 * dt * z[1], z[1], 1.0
    w, zeta = p[0], p[1]
    e, r, before = m[0] - (z[0] - 0.5 * dt * z[1]), m[1] - z[1], m[1]
    middle = e + 0.5 * dt * r
    stiff = w * w * min(max(1.0 + p[3] * middle * middle, 0.04), 1e4)
    sigma, wd = zeta * w, math.sqrt(max(stiff - zeta * zeta * w * w, 1e-12 * w * w))
    decay, c, s = math.exp(-sigma * dt), math.cos(wd * dt), math.sin(wd * dt)
    m[0] = z[0] + 0.5 * dt * z[1] + decay * (e * c + (r + sigma * e) / wd * s)
    m[1] = z[1] + decay * (r * c - (stiff * e + sigma * r) / wd * s)
    out[0] -= p[2] * (m[1] - before) / dt


def _attach(plant: StateSpace, values: Sequence[float], position: int, rate: int) -> StateSpace:
    """Return the plant with a mass on an axis: two more states, its position and velocity."""
    w, zeta, ratio = values[:3]
    n = plant.order
    pull = np.zeros(n + 2)
    pull[[position, rate, n, n + 1]] = w * w, 2 * zeta * w, -w * w, -2 * zeta * w
    A = np.zeros((n + 2, n + 2))
    A[:n, :n] = plant.A
    A[rate] -= ratio * pull
    A[n, n + 1], A[n + 1] = 1.0, pull
    return StateSpace(A, np.vstack([plant.B, np.zeros((2, plant.inputs))]), np.hstack([plant.C, np.zeros((plant.outputs, 2))]), plant.D)


def _extend(plant: StateSpace, values: Sequence[float], column: int) -> StateSpace:
    w, zeta, shares = values[0], values[1], np.array(values[2:])
    n = plant.order
    A = np.block([[plant.A, np.zeros((n, 2))], [np.zeros((2, n)), np.array([[0.0, 1.0], [-w * w, -2 * zeta * w]])]])
    drive = np.zeros((2, plant.inputs))
    drive[1, column] = w * w
    C = np.hstack([plant.C, np.outer(shares, [1.0, 0.0])])
    return StateSpace(A, np.vstack([plant.B, drive]), C, plant.D)


def _hardened(peaks: Sequence[float], unit: float) -> list[tuple[float, float, float, float]]:
    """Return starts with a spring that hardens: such a mode peaks above its frequency at rest, and from a straight spring at the
    peak a fit ends in a softening one."""
    lower, zeta, bend = HARDENED
    return [(lower * w, zeta, 0.0, bend * unit) for w in peaks]


class FlexibleMode:
    """A resonance the model does not have, one hypothesis per input that could drive it and per axis that could carry it."""

    name = "flexible_mode"
    summary = "a resonance of the structure beside the modelled dynamics"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per input and per axis, started at the peaks of the residual and on a logarithmic grid."""
        low, high = 0.02 * machine.bandwidth, min(2 * machine.bandwidth, 0.9 * math.pi / machine.dt)
        grid = [*machine.peaks, *np.geomspace(low * 3, high * 0.8, 5)]
        band = Coefficient("frequency", "rad/s", low, high, 0.02 * low), Coefficient("damping ratio", "", 1e-3, DAMPED, 0.02)
        words = {
            "physics": self.name, "family": "mode", "predicts": "a linear residual around one frequency, the same at every level",
            "refuted_by": "a residual that repeats at unexcited lines or changes its share with the level",
        }
        for axis in machine.axes:
            yield at_force(
                axis, appendage, [position(axis), velocity(axis)], memory=3, notes={"variant": ATTACHED},
                parameters=[*band, Coefficient("mass ratio", "", 0.0, 2.0, 0.02, linear=True)],
                starts=[(w, zeta, 0.0) for w in grid for zeta in (0.02, 0.15)],
                linear=lambda plant, values, q=axis.position.index, v=axis.rate.index: _attach(plant, values, q, v), **words,
            )
            unit = axis.position.rms**-2
            bend = Coefficient("hardening", f"1/{axis.position.unit}^2", -unit, 10 * unit, 0.01 * unit, nuisance=True)
            yield at_force(
                axis, bent_appendage, [position(axis), velocity(axis)], memory=3, notes={"variant": f"{ATTACHED} on a bent spring", "of": ATTACHED},
                parameters=[*band, Coefficient("mass ratio", "", 0.0, 2.0, 0.02, linear=True), bend],
                starts=[*_hardened(machine.peaks, unit), *((w, zeta, 0.0, 0.0) for w in grid for zeta in (0.02, 0.15))], **words,
            )
        for port in machine.inputs:
            shares = [
                Coefficient(
                    f"share at {o.name}", f"{o.unit}/{port.unit}", -1e3 * r / port.rms, 1e3 * r / port.rms, r / port.rms, linear=True
                )
                for o, r in zip(machine.outputs, machine.residual, strict=True)
            ]
            yield on_machine(
                "output", mode, [Signal("u", port.index)], [Signal("y", o.index) for o in machine.outputs],
                memory=2, parameters=[*band, *shares],
                starts=[(w, zeta, *np.zeros(len(shares))) for w in grid for zeta in (0.02, 0.15)],
                linear=lambda plant, values, column=port.index: _extend(plant, values, column),
                notes={"variant": port.name}, **words,
            )
