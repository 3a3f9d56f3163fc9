"""Scoring what `explain` said about a field trial.

Names alone are scored: a law has no one place on a machine of which only an input and an output are known. Every name belongs to one
of four groups: right for a hidden law, defensible for one, there by the conditions (noise, drift, offset, resolution), or false.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from afdsvc.errors import Refused
from afdsvc.lti.statespace import Array
from afdsvc.trial.answer import FieldAnswer
from afdsvc.trial.effect import Effect, Truth
from afdsvc.trial.field.generate import STATED, FieldTrial
from afdsvc.trial.field.simulation import Run, Signals, modelled
from afdsvc.trial.oracle import STEP, Oracle
from afdsvc.trial.score import CONFIDENT

Entry = Mapping[str, Any]
GOOD = {"nothing": ("right",), "one": ("first",), "several": ("first",), "outside": ("first", "among", "partial", "unexplained")}


@dataclass(frozen=True, slots=True)
class FieldScore:
    """What came of one field trial.

    ``question``: nothing, one, several (laws in the vocabulary), outside (at least one is not). ``outcome``: *first* the first name is
    right; *among* a right one is among the names; *partial* a defensible one is; *unexplained* a gap was reported and nothing claimed;
    *silent* no gap was reported, or only what is there by the conditions; *false* all that was named is false; *error*; with nothing hidden: *right*, *unexplained*, *false* or
    *error*. ``right``: the outcome is a good answer to the question. ``consistent_wrongly``: "consistent" although
    something is hidden. ``false_name``: a false name is among the names; ``confident_false``: one with a weight of 0.9 or more.
    ``rho`` is the share asked for, ``claimed`` the share the first name claims (None when it claims none),
    ``held_share`` the improvement on the holdout over the oracle's.
    """

    question: str
    family: str
    repeating: bool
    truth: str
    rho: float
    verdict: str
    said: str
    outcome: str
    right: bool
    consistent_wrongly: bool
    false_name: bool
    confident_false: bool
    claimed: float | None
    held_share: float | None

    def as_json(self) -> dict[str, Any]:
        """Return the score as plain values."""
        return asdict(self)


def field_score(explanation: Mapping[str, Any], answer: FieldAnswer, oracle: Oracle | None = None) -> FieldScore:
    """Return the score of an answer of `explain --json`; without an oracle the held-out share stays None."""
    verdict, entries = str(explanation.get("verdict", "none")), list(explanation.get("named", []))
    false = [e for e in entries if _group(answer, e) == "false"]
    question, found = _question(answer), outcome(answer, verdict, entries)
    return FieldScore(
        question=question,
        family=answer.family,
        repeating=bool(answer.conditions.get("repeating")),
        truth=" + ".join(h.accept[0] if h.accept else "outside" for h in answer.hidden) or "nothing",
        rho=answer.asked,
        verdict=verdict,
        said=str(entries[0].get("physics", "?")) if entries else verdict,
        outcome=found,
        right=found in GOOD[question],
        consistent_wrongly=bool(answer.hidden) and verdict == "consistent",
        false_name=bool(false),
        confident_false=any(float(e.get("weight", 1.0)) >= CONFIDENT for e in false),
        claimed=entries[0].get("share") if entries else None,
        held_share=_held_share(explanation, oracle) if oracle and answer.hidden else None,
    )


def _group(answer: FieldAnswer, entry: Entry) -> str:
    """Return whether a name is right, partial (defensible), present (there by the conditions) or false."""
    name = str(entry.get("physics", ""))
    if any(name in h.accept or any(word in name for word in h.words) for h in answer.hidden):
        return "right"
    if any(name in h.partial for h in answer.hidden):
        return "partial"
    return "present" if name in answer.present else "false"


def outcome(answer: FieldAnswer, verdict: str, entries: list[Entry]) -> str:
    """Return what an explanation comes to; see `FieldScore`."""
    groups = [_group(answer, e) for e in entries]
    if verdict in ("error", "none"):
        return "error"
    if answer.hidden and "right" in groups:
        return "first" if groups[0] == "right" else "among"
    if answer.hidden and "partial" in groups:
        return "partial"
    if "false" in groups:
        return "false"
    if verdict == "unexplained":
        return "unexplained"
    return "silent" if answer.hidden else "right"


def _question(answer: FieldAnswer) -> str:
    if not answer.hidden:
        return "nothing"
    if answer.outside:
        return "outside"
    return "one" if len(answer.hidden) == 1 else "several"


def _held_share(explanation: Mapping[str, Any], oracle: Oracle) -> float | None:
    """Return the share of the oracle's improvement that was reached, errors relative to each output's variation; None when the oracle
    gains less than one per cent, or figures are missing."""
    fits = list(explanation.get("fit", {}).get("per_output", {}).values())
    try:
        before, after = (sum(float(fit[key]["nrmse"]) ** 2 for fit in fits) for key in ("before", "after"))
    except (KeyError, TypeError, ValueError):
        return None
    return (1.0 - after / before) / oracle.gain if before > 0 and oracle.gain >= 0.01 else None


LONGEST = 2  # recordings the laws are refitted to: with more the oracle gains next to nothing
Data = list[tuple[Run, Signals]]


def field_oracle(trial: FieldTrial) -> Oracle:
    """Return the errors on the holdout, relative to each output's variance and averaged over the outputs.

    ``before`` with the nominal model, ``after`` with the true laws and one Gauss-Newton step of their parameters and the
    machine's constants from the truth (or the truth itself, where the step is worse), ``floor`` with the truth.
    """
    truth = Truth(trial.truth.theta, trial.truth.effects)
    before, floor = _missed(trial, Truth(trial.rig.nominal)), _missed(trial, truth)
    try:
        after = min(floor, _missed(trial, _refitted(trial, truth)))
    except Refused:
        after = floor
    return Oracle(before, after, floor, "loop" if trial.rig.loop else "commands")


def _missed(trial: FieldTrial, truth: Truth) -> float:
    run, played = trial.runs[-1], trial.played[-1]
    y = played.y[run.skip :]
    error = y - modelled(trial.rig, truth, run, played)[run.skip :]
    return float((np.square(error).mean(axis=0) / y.var(axis=0)).mean())


def _refitted(trial: FieldTrial, truth: Truth) -> Truth:
    """Return the truth one Gauss-Newton step nearer to the recordings, constants held by what the owner states."""
    data = list(zip(trial.runs[:-1], trial.played[:-1], strict=True))[:LONGEST]
    residual = _residual(trial, truth, data)
    count, sd = _free(trial, truth), float(np.sqrt(np.square(residual).mean()))
    columns = [(residual - _residual(trial, _moved(trial, truth, STEP * row), data)) / STEP for row in np.eye(count)]
    held = np.flatnonzero(trial.rig.loose > 0)
    known = np.maximum(trial.rig.loose[held] * (trial.conditions.stated or STATED), 1e-3)
    now, nominal = truth.theta[held], trial.rig.nominal[held]
    prior, pull = np.zeros((held.size, count)), (nominal - now) / (np.abs(nominal) * known)
    prior[:, : held.size] = np.diag(now / (nominal * known) * np.sign(nominal))
    left = np.vstack([np.column_stack(columns) / sd, prior])
    shift, *_ = np.linalg.lstsq(left, np.concatenate([residual / sd, pull]), rcond=1e-10)
    return _moved(trial, truth, shift)


def _residual(trial: FieldTrial, truth: Truth, data: Data) -> Array:
    """Return the simulation errors over the rms of each output, as one column."""
    parts = []
    for run, played in data:
        y = played.y[run.skip :]
        parts.append(np.ravel((y - modelled(trial.rig, truth, run, played)[run.skip :]) / y.std(axis=0)))
    return np.concatenate(parts)


def _free(trial: FieldTrial, truth: Truth) -> int:
    return int((trial.rig.loose > 0).sum()) + sum(len(e.free) for e in truth.effects)


def _moved(trial: FieldTrial, truth: Truth, shift: Array) -> Truth:
    """Return the truth with every free value changed by these relative shifts: constants, then the laws' parameters."""
    held = np.flatnonzero(trial.rig.loose > 0)
    theta, rest = truth.theta.copy(), list(shift[held.size :])
    theta[held] *= 1.0 + shift[: held.size]
    return Truth(theta, tuple(_shifted(e, [rest.pop(0) for _ in e.free]) for e in truth.effects))


def _shifted(effect: Effect, shifts: list[float]) -> Effect:
    values = effect.values.copy()
    for i, shift in zip(effect.free, shifts, strict=True):
        values[i] *= 1.0 + shift
    return effect.with_values(values)
