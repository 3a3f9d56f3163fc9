"""Where recordings are too short to tell a gap from noise, that is the verdict."""

from types import SimpleNamespace

import pytest

from afdsvc.explain.report.report import _excited, _nearest
from afdsvc.explain.verdict.verdict import Verdict


@pytest.mark.parametrize(
    ("word", "present", "enough", "claims", "said"),
    [
        ("consistent", False, False, (), "insufficient_excitation"), ("consistent", False, True, (), "consistent"),
        ("unexplained", False, False, (), "insufficient_excitation"), ("unexplained", True, False, (), "unexplained"),
        ("unexplained", False, True, (), "unexplained"), ("omitted_physics", False, False, ("a name",), "omitted_physics"),
    ],
)  # fmt: skip
def test_recordings_too_short_to_tell_a_gap_from_noise_are_insufficient(word, present, enough, claims, said):
    gap = SimpleNamespace(present=present, enough=enough)
    answer = _excited(Verdict(word, claims, ("the gap",), gap, None, (0.0, 0.0)), [])
    assert answer.verdict == said
    assert answer.sentences[-1] == "the gap"
    assert (len(answer.sentences) > 1) == (said == "insufficient_excitation")


@pytest.mark.parametrize(
    ("word", "accepted", "listed"),
    [("unexplained", False, 1), ("insufficient_excitation", True, 1), ("insufficient_excitation", False, 0), ("consistent", True, 0), ("omitted_physics", True, 0)],
)
def test_laws_that_come_nearest_are_listed_where_none_is_named(word, accepted, listed):
    law = SimpleNamespace(hypothesis=SimpleNamespace(physics="coulomb_friction", site="state:speed"), evidence=SimpleNamespace(explained=0.82))
    shape = SimpleNamespace(hypothesis=law.hypothesis, evidence=SimpleNamespace(explained=0.81))
    found = SimpleNamespace(steps=[SimpleNamespace(candidates=[shape, law], accepted=accepted)])
    near = _nearest(found, Verdict(word, (), (), None, None, (0.0, 0.0)))
    assert len(near) == listed
    assert all("coulomb friction would close 82 % of the gap" in n.sentence for n in near)
