"""Where recordings are too short to tell a gap from noise, that is the verdict."""

from types import SimpleNamespace

import pytest

from afdsvc.explain.report.report import _excited
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
