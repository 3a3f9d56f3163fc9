"""Scores of hand-made explanations of field trials."""

from __future__ import annotations

import pytest

from afdsvc.trial import FieldAnswer, Oracle, field_score
from afdsvc.trial.answer import HiddenLaw

KNOWN = HiddenLaw("a", "state:speed", 0.6, {}, ("coulomb_friction",), ("stribeck_friction", "dead_zone"), ())
STRANGE = HiddenLaw("b", "machine", 0.6, {}, (), ("saturation",), ("overflow",))
PRESENT = ("coloured_noise", "sensor_offset")


def answer(*hidden: HiddenLaw) -> FieldAnswer:
    return FieldAnswer("motor", hidden, 0.6, 0.6, PRESENT, {"repeating": False, "excitation": "steps"}, "0", {})


def said(*names: str, verdict: str = "omitted_physics", weight: float = 0.95, **more) -> dict:
    return {"verdict": verdict, "named": [{"physics": n, "weight": weight, "site": "machine", **more} for n in names]}


@pytest.mark.parametrize(
    ("hidden", "document", "outcome", "right", "confident"),
    [
        ((KNOWN,), said("coulomb_friction", "backlash", weight=0.5), "first", True, False),
        ((KNOWN,), said("backlash", "coulomb_friction", weight=0.5), "among", False, False),
        ((KNOWN,), said("dead_zone"), "partial", False, False),
        ((KNOWN,), said("dead_zone", verdict="unexplained"), "partial", False, False),
        ((KNOWN,), said("backlash"), "false", False, True),
        ((KNOWN,), said("backlash", weight=0.6), "false", False, False),
        ((KNOWN,), said(verdict="consistent"), "silent", False, False),
        ((KNOWN,), said(verdict="insufficient_excitation"), "silent", False, False),
        ((KNOWN,), said("coloured_noise"), "silent", False, False),
        ((KNOWN,), said(verdict="unexplained"), "unexplained", False, False),
        ((KNOWN,), {"verdict": "error"}, "error", False, False),
        ((STRANGE,), said(verdict="unexplained"), "unexplained", True, False),
        ((STRANGE,), said("tank_overflow"), "first", True, False),
        ((STRANGE,), said("saturation"), "partial", True, False),
        ((STRANGE,), said("coulomb_friction"), "false", False, True),
        ((STRANGE, KNOWN), said("saturation", "coulomb_friction"), "among", True, False),
        ((), said(verdict="consistent"), "right", True, False),
        ((), said("coloured_noise"), "right", True, False),
        ((), said("dead_zone"), "false", False, True),
        ((), said(verdict="unexplained"), "unexplained", False, False),
    ],
)
def test_outcome(hidden, document, outcome, right, confident) -> None:
    s = field_score(document, answer(*hidden))
    assert (s.outcome, s.right, s.confident_false) == (outcome, right, confident)
    assert s.consistent_wrongly == (bool(hidden) and document["verdict"] == "consistent")


def test_questions_and_labels() -> None:
    labels = [field_score(said(), answer(*h)) for h in ((), (KNOWN,), (KNOWN, KNOWN), (KNOWN, STRANGE))]
    assert [s.question for s in labels] == ["nothing", "one", "several", "outside"]
    assert labels[3].truth == "coulomb_friction + outside"


def test_a_second_confident_false_name_counts() -> None:
    s = field_score(said("coulomb_friction", "backlash"), answer(KNOWN))
    assert (s.outcome, s.false_name, s.confident_false) == ("first", True, True)


def test_claimed_share_is_kept_where_there_is_one() -> None:
    assert field_score(said("coulomb_friction", share=0.73), answer(KNOWN)).claimed == 0.73
    assert field_score(said("coulomb_friction"), answer(KNOWN)).claimed is None


def test_held_share_is_one_for_the_oracle_itself() -> None:
    best = Oracle(0.16, 0.04, 0.04, "commands")
    fit = {"fit": {"per_output": {"speed": {"before": {"nrmse": 0.4}, "after": {"nrmse": 0.2}}}}}
    assert field_score(said("dead_zone") | fit, answer(KNOWN), best).held_share == pytest.approx(1.0)
    assert field_score(said("dead_zone"), answer(KNOWN), best).held_share is None
    assert field_score(said() | fit, answer(), best).held_share is None
