"""A law without a form: a piecewise linear curve at one site, as a hypothesis that the search can fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Machine, Signal, Size
from afdsvc.lti.statespace import Array

HALF = (0.03, 0.2, 0.5, 1.0)  # knots over the largest speed, on either side of rest
KNOTS = 9
REACH = (0.5, 99.5)  # percentiles of the signal between which the knots lie


def curve(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """Add the ordinate at ``z[0]``: straight lines between ``k`` knots ``p[:k]`` with ordinates ``p[k:]``, continued outwards."""
    k = len(p) // 2
    i = 0
    while i < k - 2 and z[0] > p[i + 1]:
        i += 1
    w = (z[0] - p[i]) / (p[i + 1] - p[i])
    out[0] += p[k + i] + w * (p[k + i + 1] - p[k + i])


@dataclass(frozen=True, slots=True, eq=False)
class LawSite:
    """Where a free law is fitted: what it reads and writes, in which units it is drawn.

    ``factor`` turns the law's values into ``unit``; ``adds`` says that the curve is drawn as signal plus change (inputs, outputs).
    """

    hypothesis: Hypothesis
    of: Size
    words: str
    against: str
    unit: str
    factor: float
    adds: bool

    @property
    def knots(self) -> Array:
        """Abscissae of the knots, ``(k,)``."""
        return np.array([c.low for c in self.hypothesis.parameters[:KNOTS]])


def site(like: Hypothesis, machine: Machine, values: Array) -> LawSite | None:
    """Return the site of a static law; None for laws with a memory, of several signals, or on the whole machine.

    ``values (n,)`` are those of the signal it reads first.
    """
    if like.memory or any(s.ahead for s in like.reads) or len(like.writes) != 1 or like.reads[0].kind not in ("u", "x", "y") or not np.ptp(values) > 0:
        return None
    read = like.reads[0]
    of = {"u": machine.inputs, "x": machine.states, "y": machine.outputs}[read.kind][read.index]
    if like.stage != "force":
        if read != like.writes[0]:
            return None
        free = _free(like, _spread(values), of.rms, "curve")
        return LawSite(free, of, f"{'input' if like.stage == 'input' else 'sensor'} {of.name}", of.name, of.unit, 1.0, True)
    axis = next((a for a in machine.axes if a.rate.index == like.writes[0].index), None)
    if axis is None or read.kind != "x":
        return None
    speed = read.index == axis.rate.index
    x = float(np.percentile(np.abs(values), REACH[1])) * np.array([*(-h for h in reversed(HALF)), 0.0, *HALF]) if speed else _spread(values)
    return LawSite(_free(like, x, axis.push, "friction" if speed else "force"), of, f"force on {axis.name}", of.name, *_force(axis), False)


def _force(axis: Axis) -> tuple[str, float]:
    return (axis.unit, 1 / axis.gain) if axis.input is not None and axis.gain else (f"{axis.rate.unit}/s".lstrip("/s") or "1/s^2", 1.0)


def _spread(values: Array) -> Array:
    low, high = np.percentile(values, REACH)
    return np.linspace(low, high, KNOTS)


def _free(like: Hypothesis, x: Array, scale: float, family: str) -> Hypothesis:
    places = [Coefficient(f"x{i + 1}", "", float(v), float(v), 1.0) for i, v in enumerate(x)]
    heights = [Coefficient(f"y{i + 1}", "", -np.inf, np.inf, 0.5 * scale, linear=True) for i in range(len(x))]
    return Hypothesis(
        "free_law", like.site, family, like.stage, curve, like.reads[:1], like.writes, (*places, *heights), ((*x, *np.zeros(len(x))),),
        substeps=like.substeps, along=like.along,
    )


def evaluated(h: Hypothesis, parameters: Array, x: Array, others: Sequence[float], dt: float) -> Array:
    """Return what a law without memory adds at ``x (k,)``, its other signals held at ``others``."""
    heights = []
    for value in x:
        out = np.zeros(len(h.writes))
        h.law(parameters, np.array([value, *others]), np.zeros(0), 1e-3 * dt, out)
        heights.append(out[0])
    return np.array(heights)


def signal_of(found: Signal, u: Array, x: Array, y: Array) -> Array:
    """Return the values of a signal from inputs, states and outputs."""
    return {"u": u, "x": x, "y": y}[found.kind][:, found.index]
