"""What the recordings held out do to names: doubted where they do not improve, withdrawn where they do worse."""

from types import SimpleNamespace

import numpy as np
import pytest

from afdsvc.explain.report import report as module
from afdsvc.explain.verdict.verdict import Claim, Verdict


def final(stated: float, refitted: float, error: float) -> Verdict:
    """Return the verdict on one claim of weight 1, with these errors of the three models on the recordings held out."""
    points = {name: SimpleNamespace(name=name, effects=()) for name in ("stated", "refitted", "final")}
    errors = {"stated": stated, "refitted": refitted, "final": error}
    hypothesis = SimpleNamespace(key="law@input:u", family="")
    found = SimpleNamespace(
        problem=SimpleNamespace(start=lambda: points["stated"], settings=SimpleNamespace(uncertain=0.8)),
        start={0.0: SimpleNamespace(point=points["refitted"], tau=1.0)}, end={0.0: SimpleNamespace(point=points["final"])},
    )
    play = SimpleNamespace(nrmse=lambda runs, point: np.array([errors[point.name]]))
    claim = Claim(SimpleNamespace(hypothesis=hypothesis), 1.0, 1, 0.5)
    verdict = Verdict("omitted_physics", (claim,), (), None, None, (0.5, 0.1))
    return module._final(found, verdict, play, SimpleNamespace(heldout=[]))[0]


@pytest.mark.parametrize(
    ("stated", "refitted", "error", "weight"),
    [(0.5, 0.4, 0.2, 1.0), (0.5, 0.4, 0.45, 0.8), (5.0, 4.0, 2.0, 0.8)],
)
def test_a_name_is_certain_only_where_the_recordings_held_out_are_followed_better(stated, refitted, error, weight):
    verdict = final(stated, refitted, error)
    assert [c.weight for c in verdict.claims] == [weight]
    assert (weight < 1) == any("no name is certain" in s for s in verdict.sentences)


def test_a_name_that_does_worse_than_the_model_as_stated_is_withdrawn():
    verdict = final(0.2, 0.2, 0.3)
    assert verdict.verdict == "unexplained"
    assert not verdict.claims
