"""A joint between several coordinates of a machine: two masses, or modes of a structure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice, product
from typing import Any

import numpy as np

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Law, Machine, Signal, Size
from afdsvc.plugins.physics.attach import at_machine, constant, placed, state, velocity

MOST_MODES = 6  # of a joint between all modes of a structure
OPPOSED = constant("deflection", "", -1.0)
EXACT = 1e-3  # share of its largest part up to which the rate of a twist may be other than a difference of velocities
MOST_STARTS = 8  # signs of the modes' shares that a search begins from


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint that deflects by ``q_1 + s_2 q_2 + ...`` and pushes axis k with ``s_k r_k`` times its force, ``-r_k`` times where ``s_k`` is 0.

    ``deflection`` is the size of its deflection where two masses are coupled, of the first position between modal coordinates;
    ``stiffness`` and ``damping`` are those of the model's spring and damper over the mass of the first axis, 0 between modal coordinates.
    ``shares`` are the coefficients ``s_2, ..., r_2, ...`` and ``starts`` their values. Between modal coordinates the ``s_k`` are
    free and every ``r_k`` is 1 (modes scaled to unit mass); between two masses the joint deflects by the difference, or by the ``twist`` that is
    a state of its own (``s_2`` is 0), and ``r_2`` is the ratio of the first mass to the second.
    """

    name: str
    axes: tuple[Axis, ...]
    positions: tuple[Size, ...]
    deflection: Size
    stiffness: float
    damping: float
    shares: tuple[Coefficient, ...]
    starts: tuple[tuple[float, ...], ...]
    twist: bool = False

    def slipping(self) -> Joint:
        """Return the joint as its velocities see it: that of a twist is the difference of its masses'."""
        if not self.twist:
            return self
        return replace(self, shares=(OPPOSED, *self.shares[1:]), starts=tuple((OPPOSED.low, *s[1:]) for s in self.starts), twist=False)


def spring(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-k d^n`` of a deflection ``d = q_1 + s_2 q_2 + ...``; axis k takes ``s_k r_k`` times that (see `Joint`), ``p = (k, n, s_2, ..., r_2, ...)``."""
    n, deflection = len(out), z[0]
    for k in range(1, n):
        deflection += p[1 + k] * z[k]
    push = p[0] * deflection ** p[1]
    out[0] -= push
    for k in range(1, n):
        out[k] -= (p[1 + k] or -1.0) * p[n + k] * push


def at_joint(
    joint: Joint, law: Law, parameters: Sequence[Coefficient], starts: Sequence[Sequence[float]], rates: bool = False, what: str = "",
    further: Sequence[Signal] = (), **rest: Any,
) -> Hypothesis:
    """Return a law of a joint, which reads the positions of its axes or their ``rates``, then ``further`` signals; the joint's shares follow its parameters."""
    push, joint = [velocity(axis) for axis in joint.axes], joint.slipping() if rates else joint
    return at_machine(
        "force", law, [*(push if rates else [state(q) for q in joint.positions]), *further], push, parameters=[*parameters, *joint.shares],
        starts=[(*own, *shares) for shares in joint.starts for own in starts], notes={"variant": f"{what} between {joint.name}".strip()}, **rest,
    )


def joints(machine: Machine) -> Iterator[Joint]:
    """Yield a joint for every two axes with a position, one for all of them where there are three to six modes, and one for every twist."""
    known = list(placed(machine))
    for pair in combinations(known, 2):
        deflection = machine.deflections.get((pair[0][1].index, pair[1][1].index))
        yield _modes(pair) if deflection is None else _masses(machine, *pair, deflection)
    if 2 < len(known) <= MOST_MODES and not machine.deflections:
        yield _modes(known)
    for twist in machine.states:
        ends = _ends(machine, twist)
        if ends is not None:
            yield _masses(machine, (ends[0], twist), (ends[1], twist), twist, True)


def _ends(machine: Machine, twist: Size) -> tuple[Axis, Axis] | None:
    """Return the axes whose velocities' difference is the rate of a state, and which a spring pulls together by it; None of any other state."""
    plant, moving = machine.plant, {s.index for a in machine.axes for s in (a.rate, a.position) if s is not None}
    if plant is None or twist.index in moving:
        return None
    rate, sizes = plant.A[twist.index], np.array([s.rms for s in machine.states])
    by_rate = {float(np.sign(rate[a.rate.index])): a for a in machine.axes if rate[a.rate.index]}
    if set(by_rate) != {1.0, -1.0}:
        return None
    one, other = by_rate[1.0], by_rate[-1.0]
    difference = np.zeros(len(rate))
    difference[[one.rate.index, other.rate.index]] = rate[one.rate.index] * np.array([1.0, -1.0])
    beside = max(float(np.abs((rate - difference) * sizes).max()), float((np.abs(plant.B[twist.index]) * [u.rms for u in machine.inputs]).max(initial=0.0)))
    pulls = plant.A[one.rate.index, twist.index] < 0 < plant.A[other.rate.index, twist.index]
    return (one, other) if pulls and beside < EXACT * np.abs(difference * sizes).max() else None


def _masses(machine: Machine, one: tuple[Axis, Size], other: tuple[Axis, Size], deflection: Size, twist: bool = False) -> Joint:
    shares = constant("deflection", "", 0.0) if twist else OPPOSED, Coefficient("mass ratio", "", 1e-2, 1e2, 0.1)
    A = None if machine.plant is None else machine.plant.A
    there, back = (0.0, 0.0) if A is None else (float(A[one[0].rate.index, other[1].index]), float(A[other[0].rate.index, one[1].index]))
    there = -there if twist else there
    damping = 0.0 if A is None else max(0.0, float(A[one[0].rate.index, other[0].rate.index]))
    ratio = back / there if min(there, back) > 0 else 1.0  # what pulls one mass pulls the other: any other ratio makes both drift
    return Joint(f"{one[0].name},{other[0].name}", (one[0], other[0]), (one[1], other[1]), deflection, there, damping, shares, ((shares[0].low, ratio),), twist)


def _modes(known: Sequence[tuple[Axis, Size]]) -> Joint:
    axes, positions = zip(*known, strict=True)
    first, *others = positions
    ratios = [first.rms / q.rms for q in others]
    units = ["" if q.unit == first.unit else f"{first.unit}/{q.unit}" for q in others]
    shares = [Coefficient(f"share of {q.name}", unit, -30 * r, 30 * r, 0.1 * r) for q, r, unit in zip(others, ratios, units, strict=True)]
    signs = islice(product((1.0, -1.0), repeat=len(ratios)), MOST_STARTS)
    equal = [1.0] * len(ratios)
    return Joint(
        ",".join(a.name for a in axes), axes, positions, first, 0.0, 0.0, (*shares, *(constant("weight", "", 1.0) for _ in ratios)),
        tuple((*(s * r for s, r in zip(row, ratios, strict=True)), *equal) for row in signs),
    )
