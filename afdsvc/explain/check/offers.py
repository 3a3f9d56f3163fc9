"""What `explain` will try on these recordings and what it will not, and what would have to be stated or recorded for the rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.api.physics import Axis, Hypothesis, Machine, Physics, Size
from afdsvc.explain.search.fit import Fit
from afdsvc.explain.search.machine import hypotheses, machine
from afdsvc.explain.search.problem import Problem

RECORDED = ("speed", "angle", "temperature")


@dataclass(frozen=True, slots=True)
class Offers:
    """``axes``: one sentence on each direction of motion; ``tried``: the sites of every law by its name; ``absent``: by name, what a law
    lacks to be tried."""

    axes: tuple[str, ...]
    tried: Mapping[str, tuple[str, ...]]
    absent: Mapping[str, str]


def offers(problem: Problem, library: Sequence[Physics]) -> Offers:
    """Return what would be tried, from the model as it is stated."""
    none = np.zeros(0)
    stated = Fit(problem.start(), (), none, none, 1.0, 0.0, none, 0.0, 0)
    found = machine(problem, stated, 0.0 if problem.regular else problem.settings.horizons[0])
    tried = _sites(hypotheses(library, found, not problem.regular))
    return Offers(tuple(_axis(a, found) for a in found.axes), tried, {p.name: _lacks(p, found) for p in library if p.name not in tried})


def _sites(offered: Sequence[Hypothesis]) -> dict[str, tuple[str, ...]]:
    sites: dict[str, list[str]] = {}
    for hypothesis in offered:
        sites.setdefault(hypothesis.physics, []).append(hypothesis.site)
    return {name: tuple(dict.fromkeys(places)) for name, places in sites.items()}


def _axis(axis: Axis, machine: Machine) -> str:
    position = f"position {axis.position.name}" if axis.position else "its position is not in the model"
    driven = f"driven by {machine.inputs[axis.input].name}" if axis.input is not None else "no input acts on it directly"
    return f"velocity {axis.rate.name}{f' [{axis.rate.unit}]' if axis.rate.unit else ''}, {position}, {driven}"


def _lacks(physics: Physics, machine: Machine) -> str:
    """Return what this law lacks: the first addition with which it would find a place."""
    axes, tone = _with_axis(machine), (machine.bandwidth,)
    placed = replace(axes, axes=tuple(replace(a, position=a.position or machine.states[0]) for a in axes.axes))
    needs = {
        "a state that is a velocity (rate_of, or a unit such as rad/s)": axes,
        f"recorded signals such as {', '.join(f'aux_{name}' for name in RECORDED)}": _with_aux(machine),
        "a tone or a peak in the residual, which shows after the fit": replace(machine, tones=tone, peaks=tone),
        "a state that decays by itself and is no velocity, such as a current, a temperature or a level": replace(machine, axes=()),
        "a second axis of motion": replace(axes, axes=axes.axes[:1] * 2),
        "a second output": replace(machine, outputs=machine.outputs[:1] * 2, residual=np.repeat(machine.residual[:1], 2)),
        "an axis of motion and a recorded aux_speed": _with_aux(replace(axes, axes=axes.axes[:1] * 2)),
        "a state that is a position, and its velocity (rate_of)": placed,
        "two axes of motion, each with a position": replace(placed, axes=placed.axes[:1] * 2),
        "a state that is a position, and recorded signals such as aux_speed": _with_aux(placed),
    }
    for words, richer in needs.items():
        if any(True for _ in physics.hypotheses(richer)):
            return words
    return "a state or a signal that this model does not have"


def _with_axis(machine: Machine) -> Machine:
    if machine.axes or not machine.states:
        return machine
    position, rate = machine.states[0], machine.states[-1]
    return replace(machine, axes=(Axis(rate.name, position if len(machine.states) > 1 else None, rate, 1.0, 0 if machine.inputs else None),))


def _with_aux(machine: Machine) -> Machine:
    return replace(machine, aux={**{name: Size(len(machine.aux) + i, name, "", 1.0, 1.0, 2.0) for i, name in enumerate(RECORDED)}, **machine.aux})
