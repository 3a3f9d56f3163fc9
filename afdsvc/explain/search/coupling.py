"""Axes that inertia couples: a force on one of them moves the others, too."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from afdsvc.api.physics import Axis, Hypothesis, Machine, Signal
from afdsvc.lti.statespace import Array

MOVED = 0.05  # of what pushes an axis, from which on a signal moves it, too
ALIKE = 0.1  # relative difference of what two signals do to the axes, up to which they act alike


def through_mechanism(h: Hypothesis, machine: Machine) -> list[Hypothesis]:
    """Return the shape of a force as it moves all axes of a mechanism; none where no input moves several.

    What one force does to all axes is known by what the model's own forces do: of a damper or a spring of the same axis (its velocity or its position in
    the model's matrix), or of the input where it acts alike, or where the axis has neither. Of code only inputs are followed: what a state does there is
    more than a force.
    """
    axis = next((a for a in machine.axes if h.stage == "force" and [s.index for s in h.writes] == [a.rate.index]), None)
    if axis is None or axis.input is None or machine.plant is None:
        return []
    port, A = machine.inputs[axis.input], machine.plant.A
    pushed = machine.plant.B[:, port.index] * math.hypot(port.rms, port.mean)
    if not _moves_others(pushed, axis, machine):
        return []
    own = next((s for s in _own(h, axis) if A[axis.rate.index, s.index]), None)
    if own is None or np.allclose(_shares(A[:, own.index], axis, machine), _shares(pushed, axis, machine), rtol=ALIKE):
        return [_along(h, Signal("u", port.index), port.name)]
    column = A[:, own.index] * (axis.push / A[axis.rate.index, own.index])
    return [_along(h, own, machine.states[own.index].name)] if not machine.code and _moves_others(column, axis, machine) else []


def _own(h: Hypothesis, axis: Axis) -> list[Signal]:
    """Return velocity and position of an axis, first the one that the law reads."""
    both = [Signal("x", s.index) for s in (axis.rate, axis.position) if s]
    return sorted(both, key=lambda s: s not in h.reads)


def _moves_others(column: Array, axis: Axis, machine: Machine) -> bool:
    """Whether accelerations are a share of what pushes any other axis."""
    return any(abs(column[a.rate.index]) > MOVED * a.push for a in machine.axes if a is not axis)


def _shares(column: Array, axis: Axis, machine: Machine) -> Array:
    """Return what acts on every axis, that on ``axis`` being 1."""
    return np.asarray(column[[a.rate.index for a in machine.axes]] / column[axis.rate.index])


def _along(h: Hypothesis, signal: Signal, name: str) -> Hypothesis:
    variant = h.notes.get("variant", "")
    notes = {**h.notes, "variant": f"{variant}; as {name} acts" if variant else f"as {name} acts", "of": h.notes.get("of", variant)}
    return replace(h, along=signal, linear=None, notes=notes)
