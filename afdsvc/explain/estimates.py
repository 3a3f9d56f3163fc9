"""Fitted parameters with standard deviations, in the words and units of people."""

from __future__ import annotations

import numpy as np

from afdsvc.explain.explanation import Estimate
from afdsvc.explain.objective import Objective, Point, tangent
from afdsvc.explain.simulator import Effect
from afdsvc.lti.statespace import Array

INCREDIBLE = 1e-9  # relative standard deviation below which a number is no information but an accident


def deviations(objective: Objective, point: Point) -> list[Array]:
    """Return the standard deviations of every effect's parameters, nuisance and initial states fitted beside them.

    From the inverse of the information matrix at the point; infinite where the data say nothing.
    """
    t = tangent(objective, point)
    used = np.abs(t.scales) > 0
    variance = np.full(len(t.scales), np.inf)
    R = t.r[:, used]
    inverse = np.linalg.pinv(R.T @ R, rcond=1e-14, hermitian=True)
    variance[used] = np.diag(inverse) * t.scales[used] ** 2
    at, found = len(point.theta) + sum(len(x) for x in point.x0), []
    for effect in point.effects:
        sd = np.sqrt(np.maximum(variance[at : at + len(effect.values)], 0.0))
        sizes = np.array([max(abs(v), c.scale) for v, c in zip(effect.values, effect.hypothesis.parameters, strict=True)])
        found.append(np.where(sd < INCREDIBLE * np.abs(sizes), np.inf, sd))  # a step that makes the simulation leave tells nothing
        at += len(effect.values)
    return found


def estimates(effect: Effect, sd: Array | None, B: Array) -> dict[str, Estimate]:
    """Return the parameters that were fitted by name; force-like ones in the unit of the input that acts there.

    Shape parameters that are no finding of their own are left out, unless nothing else was fitted.
    """
    free = [(j, c) for j, c in enumerate(effect.hypothesis.parameters) if c.free]
    told = [(j, c) for j, c in free if not c.nuisance] or free
    found = {}
    for j, c in told:
        factor = 1.0 if c.through is None or B[c.through] == 0 else 1 / float(B[c.through])
        spread = None if sd is None or not np.isfinite(sd[j]) else float(sd[j] * abs(factor))
        found[c.name] = Estimate(float(effect.values[j]) * factor, spread, c.unit)
    return found
