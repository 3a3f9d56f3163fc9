"""Scoring what `explain` said against what was hidden."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from afdsvc.trial.answer import Hidden, TrialAnswer
from afdsvc.trial.catalogue import CHANGE
from afdsvc.trial.machine import TrialMachine
from afdsvc.trial.machines import Options
from afdsvc.trial.matching import honest_pair, means, same_place
from afdsvc.trial.oracle import Oracle

CONFIDENT = 0.9  # weight from which a name counts as said with confidence
BEYOND_PRIOR = 3.0  # stated standard deviations from which a change of a parameter is a finding
NAMING = ("omitted_physics", "parameter_change")
Entry = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Score:
    """What came of one trial.

    ``question``: nothing, physics, change, two, outside; ``truth`` and ``said`` are labels for the confusion matrix.
    ``verdict_ok``: the verdict is of the right class. ``first``: the first name is right (for a lost gain: or the honest pair
    of actuator and sensor); ``in_set``: the right one is among the named; ``place``: the first name's site is right;
    ``both``: every one of two effects is among the named; these are None where the question does not ask them.
    ``false_name``: something was named that is not there; ``confident_false``: with a weight of 0.9 or more and nothing that
    is there among the look-alikes. ``extra_false``: beside the first, a further effect is named that is not there.
    ``located``: the first location is at the right output. ``held_share``: share of the
    oracle's improvement on the holdout.
    """

    question: str
    truth: str
    rho: float
    verdict: str
    said: str
    verdict_ok: bool
    first: bool | None
    in_set: bool | None
    place: bool | None
    both: bool | None
    false_name: bool
    confident_false: bool
    extra_false: bool
    located: bool | None
    held_share: float | None

    def as_json(self) -> dict[str, Any]:
        """Return the score as plain values."""
        return asdict(self)


def score(explanation: Mapping[str, Any], answer: TrialAnswer, oracle: Oracle | None = None) -> Score:
    """Return the score of an answer of `explain --json`; without an oracle the held-out share stays None."""
    machine = Options(machine=answer.machine).build()
    verdict = str(explanation.get("verdict", "none"))
    entries = list(explanation.get("named", [])) if verdict in NAMING else []
    expected = expected_verdicts(answer)
    asked = _asked(answer)
    right = [any(means(machine, h, e) for e in entries) for h in answer.hidden]
    first = bool(entries) and _first(machine, answer, entries)
    return Score(
        question=question(answer),
        truth=truth_label(answer),
        rho=max((h.rho_asked for h in answer.hidden), default=0.0),
        verdict=verdict,
        said=_label(entries[0]) if entries else verdict,
        verdict_ok=verdict in expected,
        first=first if asked else None,
        in_set=any(right) if asked else None,
        place=_place(machine, answer, entries) if asked else None,
        both=all(right) if len(answer.hidden) == 2 and asked else None,
        false_name=_false(machine, answer, entries[:1]),
        confident_false=_false(machine, answer, entries) and _weight(entries[:1]) >= CONFIDENT,
        extra_false=any(_false(machine, answer, group) for group in _further(entries)),
        located=_located(answer, explanation) if answer.hidden else None,
        held_share=held_share(explanation, oracle) if oracle and first else None,
    )


def question(answer: TrialAnswer) -> str:
    """Return what kind of question a trial is."""
    if not answer.hidden:
        return "nothing"
    if answer.outside:
        return "outside"
    if len(answer.hidden) > 1:
        return "two"
    return "change" if answer.hidden[0].physics == CHANGE else "physics"


def truth_label(answer: TrialAnswer) -> str:
    """Return what was hidden, in one word."""
    return " + ".join(h.physics + (f" ({h.parameter})" if h.parameter else "") for h in answer.hidden) or "nothing"


def expected_verdicts(answer: TrialAnswer) -> set[str]:
    """Return the verdicts that are right.

    With an excitation that cannot tell (a sine, ordinary operation) saying so is right as well, and so is "consistent". Noise
    other than stated is no missing physics of the machine, but it is there: with nothing else hidden "unexplained" and, where
    it is coloured or drives the states, the name coloured noise are right too.
    """
    kinds = {"nothing": {"consistent"}, "outside": {"unexplained"}, "change": {CHANGE}}
    expected = set(kinds.get(question(answer), {"omitted_physics"}))
    if question(answer) == "two" and all(h.physics == CHANGE for h in answer.hidden):
        expected = {CHANGE}
    if not _asked(answer):
        expected.add("consistent")
    if answer.options.get("excitation") in ("sine", "operation"):
        expected |= {"insufficient_excitation", "consistent"}
    if answer.options.get("noise", "white") != "white" and not answer.hidden:
        expected |= {"unexplained", "omitted_physics"}
    return expected


def _asked(answer: TrialAnswer) -> bool:
    """Return whether a name is asked for: not with nothing hidden, physics outside the vocabulary, or a change inside the
    stated uncertainty."""
    if not answer.hidden or answer.outside:
        return False
    return any(h.in_prior is None or h.in_prior >= BEYOND_PRIOR for h in answer.hidden)


def _first(machine: TrialMachine, answer: TrialAnswer, entries: list[Entry]) -> bool:
    hidden = answer.hidden
    return any(means(machine, h, entries[0]) for h in hidden) or any(honest_pair(machine, h, entries) for h in hidden)


def _place(machine: TrialMachine, answer: TrialAnswer, entries: list[Entry]) -> bool:
    if not entries:
        return False
    site = str(entries[0].get("site", ""))
    return any(same_place(machine, h, site) for h in answer.hidden) or _first(machine, answer, entries)


def _false(machine: TrialMachine, answer: TrialAnswer, entries: list[Entry]) -> bool:
    """Return whether something is named and none of it is there; dirt and noise that was put in are there."""
    return bool(entries) and not any(_there(machine, answer, e) for e in entries)


def _further(entries: list[Entry]) -> list[list[Entry]]:
    """Return the names of every effect after the first, effect by effect; coloured noise is an effect of its own."""
    groups: dict[tuple[int, bool], list[Entry]] = {}
    for e in entries:
        groups.setdefault((int(e.get("effect", 1)), e.get("physics") == "coloured_noise"), []).append(e)
    return list(groups.values())[1:]


def _there(machine: TrialMachine, answer: TrialAnswer, entry: Entry) -> bool:
    present: tuple[Hidden, ...] = (*answer.hidden, *answer.minor)
    noise = answer.options.get("noise", "white") in ("coloured", "process") and entry.get("physics") == "coloured_noise"
    return noise or any(means(machine, h, entry) for h in present) or any(honest_pair(machine, h, [entry]) for h in present)


def _weight(entries: list[Entry]) -> float:
    return max((float(e.get("weight", 1.0)) for e in entries), default=0.0)


def _label(entry: Entry) -> str:
    physics = str(entry.get("physics", "?"))
    if physics != CHANGE:
        return physics
    return f"{physics} ({', '.join(map(str, entry.get('parameters', {})))})"


def _located(answer: TrialAnswer, explanation: Mapping[str, Any]) -> bool:
    """Return whether the first location names the output in which most is to be seen, or one with half as much."""
    places = list(explanation.get("located", []))
    most = max(answer.seen.values())
    return bool(places) and answer.seen.get(str(places[0].get("output")), 0.0) >= 0.5 * most


def held_share(explanation: Mapping[str, Any], oracle: Oracle) -> float | None:
    """Return the share of the oracle's improvement on the holdout that the explanation reached.

    Both improvements are taken relative to their own error before, so that it does not matter how errors are simulated. The
    outputs are summed in units of their noise. None when the oracle gains less than one per cent, or figures are missing.
    """
    if oracle.gain < 0.01:
        return None
    before = after = 0.0
    for fit in explanation.get("fit", {}).get("per_output", {}).values():
        try:
            floor = float(fit["noise_floor_nrmse"])
            before += (float(fit["before"]["nrmse"]) / floor) ** 2
            after += (float(fit["after"]["nrmse"]) / floor) ** 2
        except (KeyError, TypeError, ValueError, ZeroDivisionError):
            return None
    return (1.0 - after / before) / oracle.gain if before > 0 else None
