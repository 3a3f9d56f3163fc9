"""Before any fit: do columns, units, timing and excitation allow an answer, and which questions can these data answer at all?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from afdsvc.api.model import Model
from afdsvc.api.signals import Trace
from afdsvc.dataset.arrays import check_columns
from afdsvc.dataset.excitation import SINE, check_excitation
from afdsvc.dataset.experiment import prepare
from afdsvc.dataset.sample_checks import CheckFinding, samples
from afdsvc.errors import BadInput
from afdsvc.explain.check.gain import gains
from afdsvc.explain.check.information import ambiguities, information
from afdsvc.explain.check.lines import caused, lines
from afdsvc.explain.check.loop import clock, loop
from afdsvc.explain.check.response import responding
from afdsvc.explain.search.build import build
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import mean_input, nominal


def check(model: Model, traces: Sequence[Trace]) -> tuple[CheckFinding, ...]:
    """Return what was found, one sentence each; those of kind "stop" forbid naming any physics.

    Raises nothing for data that do not fit: the refusal is a finding.
    """
    try:
        runs = prepare(model, traces)
        nom = nominal(model, runs[0].dt, mean_input(runs))
    except BadInput as error:
        return (CheckFinding("stop", "columns", str(error)),)
    problem = build(nom, runs, Settings())
    response = caused(problem)
    return (
        *check_columns(model, traces, runs),
        *loop(nom, runs),
        *clock(problem),
        *samples(model, runs),
        *responding(nom, runs),
        *gains(nom, lines(problem, response), runs),
        *check_excitation(model, runs),
        *information(problem, response),
        *ambiguities(model, runs),
    )


def checked(model: Model, traces: Sequence[Trace], trust_units: bool = False) -> tuple[CheckFinding, ...]:
    """Return what `check` found; raises `BadInput` where it forbids naming any physics (excitation apart).

    ``trust_units`` makes warnings of what looks like wrong units or signs.
    """
    findings = check(model, traces)
    if trust_units:
        findings = tuple(replace(f, kind="warning") if f.topic == "units" and f.kind == "stop" else f for f in findings)
    if objection(findings):
        raise BadInput(objection(findings))
    return findings


def objection(findings: Sequence[CheckFinding]) -> str:
    """Return why nothing should be named from these recordings (units, signs, columns), "" when nothing forbids it."""
    return " ".join(f.sentence for f in findings if f.kind == "stop" and f.topic != "excitation")


def insufficient_excitation(findings: Sequence[CheckFinding]) -> str:
    """Return why the excitation allows no answer, with the burst that would; "" when it suffices."""
    return " ".join(f.sentence for f in findings if f.kind == "stop" and f.topic == "excitation")


def one_frequency(findings: Sequence[CheckFinding]) -> str:
    """Return what inputs excited at one frequency leave open; "" when every excited input has more."""
    said = [f.sentence for f in findings if f.topic == SINE]
    return " ".join(said) if said and not any(f.topic == "inputs" and f.kind == "ok" for f in findings) else ""
