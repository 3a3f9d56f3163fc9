"""Flexible mode: a resonance beside the modelled dynamics, driven by an input and seen at the outputs, or a mass on an axis."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Machine, Signal
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.attach import at_force, at_machine, balance, placed, velocity

Band = tuple[Coefficient, Coefficient]
ATTACHED = "attached mass"
_NUMBER = "", " of the second"
HARDENED = (0.88, 0.04, 0.003), (0.83, 0.04, 5.0)  # weakly and strongly: of the peak's frequency, damping ratio, bend in units of the motion
DAMPED = 0.25  # damping ratio above which a structure has no resonance to speak of: its amplification is below two


def mode(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``q'' + 2 zeta w q' + w^2 q = w^2 u``, seen as ``r_j q`` at output j; exact for an input held over the step; ``m = (q, q'/w)``."""
    w, zeta = p[0], p[1]
    decay, wd = math.exp(-zeta * w * dt), w * math.sqrt(max(1 - zeta * zeta, 1e-12))
    c, s = math.cos(wd * dt), math.sin(wd * dt)
    e, v = m[0] - z[0], w * m[1]
    m[0] = z[0] + decay * (e * c + (v + zeta * w * e) / wd * s)
    m[1] = decay * (v * c - (w * w * e + zeta * w * v) / wd * s) / w
    for j in range(len(out)):
        out[j] += p[2 + j] * m[0]


def masses(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """Masses ``p[3 k + 2]`` (of the axis' own) on springs: ``e'' = -w^2 e - 2 zeta w e' - v'``, each pulling back ``p[3 k + 2] s''``, ``s' = v + e'``.

    Exact for a velocity ``z[0]`` held over the step; the pull is its mean, so no momentum is lost. ``m`` holds ``w e`` and ``s'`` of every mass. Where further signals are
    read, with their nominal coefficients behind the masses, the masses are parts of the axis' own and all of it stays the same.
    """
    n, given, own = len(m) // 2, 0.0, 0.0
    if m[2 * n] == 0.0:
        m[2 * n] = 1.0
        for k in range(n):
            m[2 * k + 1] += z[0]
    for k in range(n):
        w, zeta = p[3 * k], p[3 * k + 1]
        decay, wd = math.exp(-zeta * w * dt), w * math.sqrt(max(1 - zeta * zeta, 1e-12))
        c, s = math.cos(wd * dt), math.sin(wd * dt)
        e, r, before = m[2 * k] / w, m[2 * k + 1] - z[0], m[2 * k + 1]
        m[2 * k] = w * decay * (e * c + (r + zeta * w * e) / wd * s)
        m[2 * k + 1] = z[0] + decay * (r * c - (w * w * e + zeta * w * r) / wd * s)
        out[0] -= p[3 * k + 2] * (m[2 * k + 1] - before) / dt
        given += p[3 * k + 2]
    for k in range(1, len(z)):
        own += p[3 * n + k - 1] * z[k]
    out[0] += given * own


def bent_spring(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """One of `masses` on a spring whose stiffness goes as ``1 + p3 e^2``, held over the step at what it is in its middle."""
    if m[2] == 0.0:
        m[1], m[2] = m[1] + z[0], 1.0
    w, zeta = p[0], p[1]
    e, r, before = m[0] / w, m[1] - z[0], m[1]
    middle = e + 0.5 * dt * r
    stiff = w * w * min(max(1.0 + p[3] * middle * middle, 0.04), 1e4)
    sigma, wd = zeta * w, math.sqrt(max(stiff - zeta * zeta * w * w, 1e-12 * w * w))
    decay, c, s = math.exp(-sigma * dt), math.cos(wd * dt), math.sin(wd * dt)
    m[0] = w * decay * (e * c + (r + sigma * e) / wd * s)
    m[1] = z[0] + decay * (r * c - (stiff * e + sigma * r) / wd * s)
    out[0] -= p[2] * (m[1] - before) / dt


def _attach(plant: StateSpace, values: Sequence[float], rate: int, count: int = 1, divided: bool = False) -> StateSpace:
    """Return the plant with ``count`` masses on an axis, hung on it or divided from it: two more states each, deflection and velocity."""
    n, ratios = plant.order, np.array(values[2 : 3 * count : 3])
    A, B = np.zeros((n + 2 * count,) * 2), np.vstack([plant.B, np.zeros((2 * count, plant.inputs))])
    A[:n, :n] = plant.A
    if divided:
        A[rate], B[rate] = A[rate] * (1 + ratios.sum()), B[rate] * (1 + ratios.sum())
    for k, ratio in enumerate(ratios):
        w, zeta = values[3 * k : 3 * k + 2]
        e = n + 2 * k
        A[e, [rate, e + 1]] = -1.0, 1.0
        A[e + 1, [rate, e, e + 1]] = 2 * zeta * w, -w * w, -2 * zeta * w
        A[rate] -= ratio * A[e + 1]
    return StateSpace(A, B, np.hstack([plant.C, np.zeros((plant.outputs, 2 * count))]), plant.D)


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
    return [(lower * w, zeta, 0.0, bend * unit) for lower, zeta, bend in HARDENED for w in peaks]


class FlexibleMode:
    """A resonance the model does not have, one hypothesis per input that could drive it and several per axis that could carry it."""

    name = "flexible_mode"
    summary = "a resonance of the structure beside the modelled dynamics"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return hypotheses per input and per axis, started at the peaks of the residual and on a logarithmic grid."""
        low, high = 0.02 * machine.bandwidth, min(2 * machine.bandwidth, 0.9 * math.pi / machine.dt)
        grid = [*machine.peaks, *np.geomspace(low * 3, high * 0.8, 5)]
        band = Coefficient("frequency", "rad/s", low, high, 0.02 * low), Coefficient("damping ratio", "", 1e-3, DAMPED, 0.02, decisive=True)
        words = {
            "physics": self.name, "family": "mode", "predicts": "a linear residual around one frequency, the same at every level",
            "refuted_by": "a residual that repeats at unexcited lines or changes its share with the level",
        }
        for axis in machine.axes:
            yield from _hung(axis, band, grid, words)
            yield from _divided(axis, machine, band, grid, words)
        for axis, q in placed(machine):
            unit = q.rms**-2
            bend = Coefficient("hardening", f"1/{q.unit}^2", -unit, 10 * unit, 0.01 * unit, nuisance=True)
            yield at_force(
                axis, bent_spring, [velocity(axis)], memory=3, unsettled=2, notes={"variant": f"{ATTACHED} on a bent spring", "of": ATTACHED},
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
            yield at_machine(
                "output", mode, [Signal("u", port.index)], [Signal("y", o.index) for o in machine.outputs],
                memory=2, unsettled=2, parameters=[*band, *shares],
                starts=[(w, zeta, *np.zeros(len(shares))) for w in grid for zeta in (0.02, 0.15)],
                linear=lambda plant, values, column=port.index: _extend(plant, values, column),
                notes={"variant": port.name}, **words,
            )


def _hung(axis: Axis, band: Band, grid: Sequence[float], words: dict[str, Any]) -> Iterable[Hypothesis]:
    """Yield a mass hung on an axis beside what the model has."""
    yield at_force(
        axis, masses, [velocity(axis)], memory=3, unsettled=2, notes={"variant": ATTACHED},
        parameters=[*band, Coefficient("mass ratio", "", 0.0, 2.0, 0.02, linear=True)],
        starts=[(w, zeta, 0.0) for w in grid for zeta in (0.02, 0.15)],
        linear=lambda plant, values, v=axis.rate.index: _attach(plant, values, v), **words,
    )


def _divided(axis: Axis, machine: Machine, band: Band, grid: Sequence[float], words: dict[str, Any]) -> Iterable[Hypothesis]:
    """Yield the axis' mass divided in two and in three: what the model takes for one rigid mass is a chain."""
    reads, terms = balance(machine, axis.rate)
    for count, starts in ((1, [(w, zeta) for w in grid for zeta in (0.02, 0.15)]), (2, _pairs(grid))) if reads else ():
        chain = [replace(c, name=f"{c.name}{_NUMBER[k]}") for k in range(count) for c in (*band, Coefficient("mass ratio", "", 0.0, 20.0, 0.05, linear=True))]
        yield at_force(
            axis, masses, [velocity(axis), *reads], memory=2 * count + 1, unsettled=2 * count, notes={"variant": f"divided in {count + 1}", "of": ATTACHED},
            parameters=[*chain, *terms],
            starts=[(*(v for k in range(count) for v in (*s[2 * k : 2 * k + 2], 0.0)), *(c.low for c in terms)) for s in starts],
            linear=lambda plant, values, v=axis.rate.index, count=count: _attach(plant, values, v, count, divided=True), **words,
        )


def _pairs(grid: Sequence[float]) -> list[tuple[float, float, float, float]]:
    """Return starts of two modes, the lower one first."""
    return [(a, 0.05, b, 0.05) for a, b in combinations(sorted(grid), 2) if b > 1.2 * a]
