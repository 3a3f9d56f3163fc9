"""A joint between several coordinates of a machine: two masses, or modes of a structure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, islice, product
from typing import Any

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Law, Machine, Signal, Size
from afdsvc.plugins.physics.attach import at_machine, constant, placed, state, velocity

MOST_MODES = 6  # of a joint between all modes of a structure
MOST_STARTS = 8  # signs of the modes' shares that a search begins from


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint that deflects by ``q_1 + s_2 q_2 + ...`` and pushes axis k with ``s_k r_k`` times its force.

    ``deflection`` is the size of its deflection where two masses are coupled, of the first position between modal coordinates;
    ``stiffness`` and ``damping`` are those of the model's spring and damper over the mass of the first axis, 0 between modal coordinates.
    ``shares`` are the coefficients ``s_2, ..., r_2, ...`` and ``starts`` their values. Between modal coordinates the ``s_k`` are
    free and every ``r_k`` is 1 (modes scaled to unit mass); between two masses the joint deflects by the difference, and
    ``r_2`` is the ratio of the first mass to the second.
    """

    name: str
    axes: tuple[Axis, ...]
    positions: tuple[Size, ...]
    deflection: Size
    stiffness: float
    damping: float
    shares: tuple[Coefficient, ...]
    starts: tuple[tuple[float, ...], ...]


def spring(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-k d^n`` of a deflection ``d = q_1 + s_2 q_2 + ...``; axis k takes ``s_k r_k`` times that, ``p = (k, n, s_2, ..., r_2, ...)``."""
    n, deflection = len(out), z[0]
    for k in range(1, n):
        deflection += p[1 + k] * z[k]
    push = p[0] * deflection ** p[1]
    out[0] -= push
    for k in range(1, n):
        out[k] -= p[1 + k] * p[n + k] * push


def at_joint(
    joint: Joint, law: Law, parameters: Sequence[Coefficient], starts: Sequence[Sequence[float]], rates: bool = False, what: str = "",
    further: Sequence[Signal] = (), **rest: Any,
) -> Hypothesis:
    """Return a law of a joint, which reads the positions of its axes or their ``rates``, then ``further`` signals; the joint's shares follow its parameters."""
    push = [velocity(axis) for axis in joint.axes]
    return at_machine(
        "force", law, [*(push if rates else [state(q) for q in joint.positions]), *further], push, parameters=[*parameters, *joint.shares],
        starts=[(*own, *shares) for shares in joint.starts for own in starts], notes={"variant": f"{what} between {joint.name}".strip()}, **rest,
    )


def joints(machine: Machine) -> Iterator[Joint]:
    """Yield a joint for every two axes with a position, and one for all of them where there are three to six modes."""
    known = list(placed(machine))
    for pair in combinations(known, 2):
        deflection = machine.deflections.get((pair[0][1].index, pair[1][1].index))
        yield _modes(pair) if deflection is None else _masses(machine, *pair, deflection)
    if 2 < len(known) <= MOST_MODES and not machine.deflections:
        yield _modes(known)


def _masses(machine: Machine, one: tuple[Axis, Size], other: tuple[Axis, Size], deflection: Size) -> Joint:
    shares = constant("deflection", "", -1.0), Coefficient("mass ratio", "", 1e-2, 1e2, 0.1)
    A = None if machine.plant is None else machine.plant.A
    there, back = (0.0, 0.0) if A is None else (float(A[one[0].rate.index, other[1].index]), float(A[other[0].rate.index, one[1].index]))
    damping = 0.0 if A is None else max(0.0, float(A[one[0].rate.index, other[0].rate.index]))
    ratio = back / there if min(there, back) > 0 else 1.0  # what pulls one mass pulls the other: any other ratio makes both drift
    return Joint(f"{one[0].name},{other[0].name}", (one[0], other[0]), (one[1], other[1]), deflection, there, damping, shares, ((-1.0, ratio),))


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
