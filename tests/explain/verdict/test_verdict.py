"""When a name is not certain although it fits best."""

from types import SimpleNamespace

import numpy as np
import pytest

from afdsvc.api.physics import Signal
from afdsvc.explain.search.evidence import HypothesisEvidence
from afdsvc.explain.search.ranking import Candidate
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import Entry
from afdsvc.explain.verdict.verdict import _claims, _complete, _explained, verdict


def candidate(physics: str) -> Candidate:
    """Return a candidate that closes nine tenths of the gap in every block."""
    hypothesis = SimpleNamespace(physics=physics, site="input:u", key=physics, title=f"{physics} (input u)", notes={}, parameters=(), reads=())
    return Candidate(hypothesis, {}, HypothesisEvidence({0.0: 900.0}, 0.9, np.ones((20, 1)), np.full((20, 1), 0.1), 400.0, 0.0))


@pytest.mark.parametrize(
    ("explained", "predictable", "present", "enough", "measured", "complete"),
    [
        (0.3, 0.9, True, True, False, 0.3 / 0.93), (0.3, 0.9, False, True, False, 1.0), (0.3, 0.9, False, False, False, 0.3 / 0.93),
        (0.3, -0.1, False, False, False, 1.0), (0.7, 0.9, False, True, True, 0.8), (0.95, 0.9, False, True, True, 1.0),
    ],
)  # fmt: skip
def test_no_name_is_surer_than_the_share_of_the_explainable_that_is_closed(explained, predictable, present, enough, measured, complete):
    """Of the residual 30 % are explained; of the other 70 % a flexible model predicts 90 %: 63 %. Too short a recording shows no absence."""
    found = SimpleNamespace(problem=SimpleNamespace(weighting=SimpleNamespace(measured=measured)))
    assert _complete(found, SimpleNamespace(present=present, enough=enough, total=predictable), (explained, 0.05)) == pytest.approx(complete)


def test_all_is_explained_where_nothing_remains_to_be_tested():
    found = SimpleNamespace(problem=SimpleNamespace(weighting=SimpleNamespace(measured=False)))
    assert _complete(found, None, (0.1, 0.0)) == 1.0


@pytest.mark.parametrize("floor", [0.0, 30.0])  # the noise of a block, none of the gap
def test_the_deviation_of_the_explained_share_is_that_of_blocks_drawn_anew(floor):
    """Blocks differ widely in what they hold of the gap, and close nearly the same share of it. The oracle is the bootstrap."""
    rng = np.random.default_rng(7)
    gap = np.exp(1.5 * rng.standard_normal(40)) * 10
    before, after = gap + floor, gap * (0.1 + 0.02 * rng.standard_normal(40)) + floor
    share = 1 - (after - floor).sum() / gap.sum()
    drawn = rng.integers(0, 40, (4000, 40))
    expected = np.std(1 - (after - floor)[drawn].sum(1) / gap[drawn].sum(1))
    found = SimpleNamespace(evidence=HypothesisEvidence({0.0: 100.0}, share, before[:, None], after[:, None], 400.0, 0.0))
    assert _explained(found) == (share, pytest.approx(expected, rel=0.15))
    assert expected < 0.01


def _found(effects: list[Candidate], evidence: HypothesisEvidence, confirmed: float = 1.0) -> SimpleNamespace:
    """Return a search that accepted these effects, with this evidence for all of them."""
    problem = SimpleNamespace(settings=Settings(), weighting=SimpleNamespace(even=True, measured=False), nominal=SimpleNamespace(entries=()))
    steps = [SimpleNamespace(accepted=True, candidates=[e], limited="model", reason="", confirmed=confirmed) for e in effects]
    return SimpleNamespace(steps=steps, problem=problem, end={0.0: SimpleNamespace(point=SimpleNamespace(theta=np.zeros(0), effects=()))}, evidence=evidence)


@pytest.mark.parametrize(("present", "certain"), [(True, [0.9 / 0.91, 0.8]), (False, [1.0, 1.0])])
def test_further_effects_are_certain_only_where_nothing_predictable_remains(present, certain):
    effects = [candidate(name) for name in ("friction", "slew")]
    found = _found(effects, effects[0].evidence)
    left = SimpleNamespace(present=present, enough=True, total=0.1, p_value=0.01, depends_on=())
    answer = verdict(found, SimpleNamespace(present=True, total=0.9, sentence=""), left)
    assert [c.weight for c in answer.claims] == pytest.approx(certain)


@pytest.mark.parametrize(("moved", "certain"), [(-3.3, True), (-6.0, False)])
def test_no_name_is_certain_where_the_model_contradicts_its_owner(moved, certain):
    found = _found([candidate("friction")], candidate("friction").evidence)
    found.end[0.0].point.theta, found.problem.nominal.entries = np.array([moved]), (Entry("A", 0, 0, 0.1),)
    answer = verdict(found, SimpleNamespace(present=True, total=0.9, sentence=""), None)
    assert (answer.claims[0].weight > Settings().uncertain) == certain
    assert any("more than 5 stated standard deviations from what is stated: no name is certain" in s for s in answer.sentences) != certain


@pytest.mark.parametrize(("confirmed", "most"), [(1.0, 1.0), (0.7, 0.7), (0.2, 0.5)])
def test_no_name_is_surer_than_the_recordings_held_out_confirm_it_beside_what_was_found_before(confirmed, most):
    """Half at least: a part of a model that follows them better as a whole is not refuted by them."""
    answer = verdict(_found([candidate("friction")], candidate("friction").evidence, confirmed), SimpleNamespace(present=True, total=0.9, sentence=""), None)
    assert answer.claims[0].weight == most
    assert any("the recordings held out do not confirm it beside what was found before" in s for s in answer.sentences) == (confirmed < 0.5)


@pytest.mark.parametrize(("changed", "kind", "certain"), [(1, "p", True), (0, "p", False), (1, "x", False)])
def test_a_number_that_changes_with_time_may_begin_far_from_what_is_stated(changed, kind, certain):
    found = _found([candidate("parameter_drift")], candidate("parameter_drift").evidence)
    effect = SimpleNamespace(hypothesis=SimpleNamespace(writes=(Signal(kind, changed),)))
    found.end[0.0].point = SimpleNamespace(theta=np.array([6.8]), effects=(effect,))
    found.problem.nominal.entries = (Entry("parameter", 1, 0, 0.1),)
    answer = verdict(found, SimpleNamespace(present=True, total=0.9, sentence=""), None)
    assert (answer.claims[0].weight > Settings().uncertain) == certain


def test_what_closes_next_to_nothing_of_what_can_be_explained_is_not_named():
    found = _found([candidate("friction")], HypothesisEvidence({0.0: 12.0}, 0.02, np.ones((20, 1)), np.full((20, 1), 0.98), 400.0, 0.0))
    answer = verdict(found, SimpleNamespace(present=True, total=0.9, sentence="a gap"), SimpleNamespace(present=True, enough=True, total=0.9, p_value=0.01, depends_on=()))
    assert (answer.verdict, answer.claims) == ("unexplained", ())
    assert any("friction (input u) closes too little" in s for s in answer.sentences)


def test_a_look_alike_that_hardly_ever_comes_first_is_not_named():
    settings, close = Settings(), candidate("viscous")
    worse = Candidate(close.hypothesis, {}, HypothesisEvidence({0.0: 700.0}, 0.7, np.ones((20, 1)), np.full((20, 1), 0.17), 400.0, 0.0))
    step = SimpleNamespace(accepted=True, candidates=[candidate("friction"), worse], limited="model")
    assert [c.candidate.hypothesis.physics for c in _claims(step, 1, 1.0, SimpleNamespace(problem=SimpleNamespace(settings=settings)))] == ["friction"]
    step.candidates[1] = close
    assert len(_claims(step, 1, 1.0, SimpleNamespace(problem=SimpleNamespace(settings=settings)))) == 2
