"""The whole check before any fit: findings, measured against simulated, and what `identify` and `explain` will try."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from afdsvc.api.model import Model
from afdsvc.api.physics import Axis, Hypothesis, Machine, Physics, Size
from afdsvc.api.signals import Trace
from afdsvc.dataset.experiment import Run, prepare
from afdsvc.dataset.sample_checks import CheckFinding
from afdsvc.errors import BadInput
from afdsvc.explain.check.check import check
from afdsvc.explain.check.comparison import Compared, compared
from afdsvc.explain.check.information import noise_sd, posterior_sd
from afdsvc.explain.search.build import build
from afdsvc.explain.search.fit import Fit
from afdsvc.explain.search.machine import hypotheses, machine
from afdsvc.explain.search.problem import Problem
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import mean_input, nominal
from afdsvc.identify.pipeline import MethodPlan, planned

RECORDED = ("speed", "angle", "temperature")
MOST = 20_000  # samples of a recording that are simulated here


@dataclass(frozen=True, slots=True)
class Offers:
    """``axes``: one sentence on each direction of motion; ``tried``: the sites of every law by its name; ``absent``: by name, what a law
    lacks to be tried."""

    axes: tuple[str, ...]
    tried: Mapping[str, tuple[str, ...]]
    absent: Mapping[str, str]


NOTHING = Offers((), {}, {})


@dataclass(frozen=True, slots=True, eq=False)
class CheckResult:
    """What can be said of a model and its recordings before any fit.

    ``findings`` are sentences of kind "ok", "warning" or "stop"; ``outputs`` measured against simulated; ``offers`` what `explain` will
    try; ``plan`` what `identify` will do; ``parameters`` by name the standard deviation after the recordings over the one stated.
    """

    model: Model
    findings: tuple[CheckFinding, ...]
    outputs: tuple[Compared, ...] = ()
    offers: Offers = NOTHING
    plan: MethodPlan = field(default_factory=MethodPlan)
    parameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """"refused" where a finding forbids a conclusion, "limited" where one limits it, else "ready"."""
        kinds = {f.kind for f in self.findings}
        return "refused" if "stop" in kinds else "limited" if "warning" in kinds else "ready"

    def json(self) -> dict[str, Any]:
        """Return the document of ``check --json``."""
        return {
            "verdict": self.verdict,
            "findings": [{"kind": f.kind, "topic": f.topic, "sentence": f.sentence} for f in self.findings],
            "outputs": {
                c.output: {"r2": c.r2, "gain": c.gain, "delay_s": c.delay, "offset": c.offset, "unit": c.unit, "how": c.how} for c in self.outputs
            },
            "explain": {"axes": list(self.offers.axes), "tried": {k: list(v) for k, v in self.offers.tried.items()}, "not_tried": dict(self.offers.absent)},
            "identify": {"method": self.plan.method, "sentence": self.plan.sentence},
            "parameters": dict(self.parameters),
        }


def check_all(model: Model, traces: Sequence[Trace], library: Sequence[Physics]) -> CheckResult:
    """Return the check of recordings against a model; what does not fit is a finding, nothing is raised for it."""
    findings = check(model, traces)
    plan = planned(model, traces)
    try:
        problem = _problem(model, prepare(model, traces))
    except BadInput:  # a finding says why
        return CheckResult(model, findings, plan=plan)
    return CheckResult(model, findings, compared(problem), offers(problem, library), plan, _parameters(problem))


def _problem(model: Model, runs: Sequence[Run]) -> Problem:
    short = [r.span(0, MOST) if len(r) > MOST else r for r in runs]
    return build(nominal(model, runs[0].dt, mean_input(runs)), short, Settings(), short)


def _parameters(problem: Problem) -> dict[str, float]:
    nominal = problem.nominal
    shares = posterior_sd(problem, noise_sd(nominal, problem.runs))
    return {e.name: float(s) for e, s in zip(nominal.entries, shares, strict=True)}


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
        "a tone or a peak in the residual: explain tries it where one shows after the fit": replace(machine, tones=tone, peaks=tone),
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
    return "a place in this model: a state or a signal is missing, or the model has this effect already"


def _with_axis(machine: Machine) -> Machine:
    if machine.axes or not machine.states:
        return machine
    position, rate = machine.states[0], machine.states[-1]
    return replace(machine, axes=(Axis(rate.name, position if len(machine.states) > 1 else None, rate, 1.0, 0 if machine.inputs else None),))


def _with_aux(machine: Machine) -> Machine:
    return replace(machine, aux={**{name: Size(len(machine.aux) + i, name, "", 1.0, 1.0, 2.0) for i, name in enumerate(RECORDED)}, **machine.aux})
