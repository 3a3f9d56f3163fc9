"""Scoring what `explain` said about a field trial.

Names alone are scored: a law has no one place on a machine of which only an input and an output are known. Every name belongs to one
of four groups: right for a hidden law, defensible for one, there by the conditions (noise, drift, offset, resolution), or false.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from afdsvc.trial.field.answer import FieldAnswer
from afdsvc.trial.scoring.oracle import Oracle
from afdsvc.trial.scoring.score import CONFIDENT

Entry = Mapping[str, Any]
SILENT = ("consistent", "insufficient_excitation")
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
    false = [e for e in entries if group(answer, e) == "false"]
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


def group(answer: FieldAnswer, entry: Entry) -> str:
    """Return whether a name is right, partial (defensible), present (there by the conditions) or false."""
    name = str(entry.get("physics", ""))
    if any(name in h.accept or any(word in name for word in h.words) for h in answer.hidden):
        return "right"
    if any(name in h.partial for h in answer.hidden):
        return "partial"
    return "present" if name in answer.present else "false"


def outcome(answer: FieldAnswer, verdict: str, entries: list[Entry]) -> str:
    """Return what an explanation comes to; see `FieldScore`."""
    groups = [group(answer, e) for e in entries]
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
