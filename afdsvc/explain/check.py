"""Before any fit: do columns, units, timing and excitation allow an answer, and which questions can this data answer at all?"""

from __future__ import annotations

from collections.abc import Sequence

from afdsvc.api.model import Model
from afdsvc.api.signals import Trace
from afdsvc.dataset.columns import columns
from afdsvc.dataset.excitation import SINE, excitation
from afdsvc.dataset.experiment import prepare
from afdsvc.dataset.finding import Finding
from afdsvc.dataset.sample_checks import samples
from afdsvc.errors import BadInput
from afdsvc.explain.check_ambiguity import ambiguities
from afdsvc.explain.check_gain import gains
from afdsvc.explain.check_information import information
from afdsvc.explain.check_lines import lines
from afdsvc.explain.check_loop import loop
from afdsvc.explain.nominal import nominal


def check(model: Model, traces: Sequence[Trace]) -> tuple[Finding, ...]:
    """Return what was found, one sentence each; those of kind "stop" forbid naming any physics.

    Raises nothing for data that do not fit: the refusal is a finding.
    """
    try:
        runs = prepare(model, traces)
        nom = nominal(model, runs[0].dt)
    except BadInput as error:
        return (Finding("stop", "columns", str(error)),)
    seen = lines(nom, runs)
    return (
        *columns(model, traces, runs),
        *loop(nom, runs),
        *samples(model, runs),
        *gains(nom, seen),
        *excitation(model, runs),
        *information(nom, runs, seen),
        *ambiguities(model, runs),
    )


def objection(findings: Sequence[Finding]) -> str:
    """Return why nothing should be named from these recordings (units, signs, columns), "" when nothing forbids it."""
    return " ".join(f.sentence for f in findings if f.kind == "stop" and f.topic != "excitation")


def insufficient_excitation(findings: Sequence[Finding]) -> str:
    """Return why the excitation cannot tell anything, with the burst that would; "" when it suffices."""
    return " ".join(f.sentence for f in findings if f.kind == "stop" and f.topic == "excitation")


def one_frequency(findings: Sequence[Finding]) -> str:
    """Return what inputs excited at one frequency leave open; "" when every excited input has more."""
    told = [f.sentence for f in findings if f.topic == SINE]
    return " ".join(told) if told and not any(f.topic == "inputs" and f.kind == "ok" for f in findings) else ""
