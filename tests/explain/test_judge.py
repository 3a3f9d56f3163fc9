"""Rulings on made-up candidates: what is chosen, what gives way, what is refused, and by which evidence."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from afdsvc.api.physics import Coefficient, Hypothesis, Signal
from afdsvc.explain.forward import Step
from afdsvc.explain.judge import CHANGE, Rival, Tried, bent, judge, separation
from afdsvc.explain.naming import _told
from afdsvc.explain.objective import Point
from afdsvc.explain.search import SETTLED, Candidate, _one_way_each, _promising
from afdsvc.explain.simulator import Effect

SAMPLES = (20000, 10000)
NOISE = SimpleNamespace(limited="noise", memory=1.0)
FEW = Tried(100, 10)


def nothing_law(p, z, m, dt, out):
    """Do nothing: these candidates are never simulated."""


def candidate(
    physics: str, gain: float = 0.0, gain_select: float = 0.0, *, site: str = "input:a", values: tuple[float, ...] = (1.0,),
    family: str = "memory", differs: float = 1e3, theta: float = 0.0, blocks: np.ndarray | None = None,
) -> Candidate:
    """Return a candidate that gains so much on the runs that fit and on those that select; parameters range from 0 to 4."""
    own = Signal("u", 0)
    parameters = tuple(Coefficient(f"p{i}", "", 0.0, 4.0, 0.1) for i in range(len(values)))
    h = Hypothesis(physics, site, family, "input", nothing_law, (own,), (own,), parameters, (values,))
    spread = np.linspace(-1, 1, 60) if blocks is None else blocks
    point = Point(np.array([theta]), (), (Effect(h, np.array(values)),))
    costs = 500.0 - (gain + gain_select) / 60 + spread
    return Candidate(h, point, 20000 - gain, 10000 - gain_select, costs, len(values), differs=differs)


def empty(theta: float = 0.0) -> Candidate:
    return Candidate(None, Point(np.array([theta]), ()), 20000.0, 10000.0, np.full(60, 500.0), 0)


def ruling(*candidates: Candidate, tried: Tried = FEW, theta: float = 0.0):
    return judge(NOISE, [empty(theta), *candidates], tried, SAMPLES)


def test_a_law_that_fails_the_selection_runs_gives_way_to_one_that_does_well_on_both():
    r = ruling(candidate("overfitting", 900, -80), candidate("right", 500, 200))
    assert r.accepted
    assert r.rivals[0].candidate.hypothesis.physics == "right"


def test_alone_it_is_refused_for_it():
    r = ruling(candidate("overfitting", 900, -80), candidate("no better", 20, 0.5))
    assert not r.accepted
    assert "does not improve the recording kept for selection" in r.reason


@pytest.mark.parametrize(("differs", "accepted"), [(1e3, False), (4.0, True)])
def test_selection_runs_are_asked_for_a_gain_only_where_the_effect_shows_in_them(differs, accepted):
    assert ruling(candidate("saturation", 300, -1.0, differs=differs)).accepted is accepted


@pytest.mark.parametrize(
    ("gain", "gain_select", "accepted"),
    [
        (1100, -2.7, True),  # where 2 % of the effect is, a hundredth of it may be lost: the form differs there
        (1100, -14.0, False),  # more than that
        (400, -2.7, False),  # where 6 % of the effect is, its form counts
    ],
)
def test_quiet_selection_runs_do_not_judge_the_exact_form_of_a_law(gain, gain_select, accepted):
    assert ruling(candidate("clearance", gain, gain_select, differs=25.8)).accepted is accepted


def test_gains_on_runs_that_were_not_fitted_count_as_evidence():
    wanted = float(stats.chi2.isf(1e-5 / 100, 1))
    assert ruling(candidate("law", wanted - 8, 9)).accepted
    assert not ruling(candidate("law", wanted - 12, 9)).accepted


def test_changes_of_constants_have_a_chance_of_error_of_their_own():
    change = candidate("parameter_change", 12.4, 2.2, family="gain")
    assert stats.chi2.isf(2e-3 / 10, 1) < 14.6 < stats.chi2.isf(2e-3 / 97, 1)
    assert ruling(change, tried=Tried(97, 10)).accepted
    assert not ruling(change, tried=Tried(97, 97)).accepted
    assert not ruling(candidate("law", 12.4, 2.2), tried=Tried(97, 10)).accepted


def test_hypotheses_are_counted_by_what_they_are():
    laws = [candidate(n, site=s).hypothesis for n, s in (("law", "input:a"), (CHANGE, "input:a"), ("law", "input:b"), (CHANGE, "input:b"))]
    assert Tried.of(laws) == Tried(4, 2)
    once_more = replace(laws[1], notes={"variant": "with its couplings"})
    assert Tried.of([*laws, once_more]) == Tried(5, 2)  # one constant, whatever else changes with it
    assert Tried.of([]) == Tried(1, 1)


@pytest.mark.parametrize(
    ("gain", "more", "first"),
    [
        (260, 18, "longer"),  # two more parameters for a faint effect: 2 ln 278 + 2 = 13.3
        (260, 12, "short"),
        (26000, 21, "short"),  # a plain one: 2 ln 26021 = 20.3, and a thousandth of what it explains tells nobody apart
        (26000, 60, "longer"),
        (2.6e6, 2700, "longer"),  # never more than the samples: 2 ln 30000 = 20.6
    ],
)
def test_a_parameter_costs_the_logarithm_of_what_there_is_to_know_of_the_effect(gain, more, first):
    longer, short = candidate("longer", gain + more, values=(1.0, 1.0, 2.0), differs=0.0), candidate("short", gain, differs=0.0)
    assert ruling(longer, short).rivals[0].candidate.hypothesis.physics == first


@pytest.mark.parametrize(
    ("shape", "site", "family", "first"),
    [
        (4.0, "input:a", "memory", "play"),  # the loop stands at its end: it is asked to be play
        (2.0, "input:a", "memory", "loop"),  # its shape is well inside
        (4.0, "input:b", "memory", "loop"),  # the other acts elsewhere
        (4.0, "input:a", "friction", "loop"),  # or is no relative
    ],
)
def test_a_law_at_the_end_of_its_range_gives_way_to_a_shorter_relative_the_data_cannot_tell_from_it(shape, site, family, first):
    rng = np.random.default_rng(3)
    loop = candidate("loop", 1000, 500, values=(1.0, 1.0, shape))
    play = candidate("play", 975, 490, site=site, family=family, blocks=np.linspace(-1, 1, 60) + 10 * rng.standard_normal(60))
    assert ruling(loop, play).rivals[0].candidate.hypothesis.physics == first


@pytest.mark.parametrize(("behind", "first"), [(40, "play"), (100, "loop")])
def test_a_shorter_relative_that_is_worse_by_more_than_a_standard_error_stays_behind(behind, first):
    noisy = 10 * np.random.default_rng(4).standard_normal(60)
    noisy -= noisy.mean()
    loop, play = candidate("loop", 1000, 500, values=(1.0, 1.0, 4.0)), candidate("play", 1000 - behind, 500, blocks=noisy)
    assert [r.candidate.hypothesis.physics for r in ruling(loop, play).rivals[:1]] == [first]
    assert len(ruling(loop, play).rivals) == 2


def test_a_choice_may_not_bend_the_model_further_than_it_was():
    r = ruling(candidate("law", 900, 400))
    assert bent(np.array([4.9, -1.0]), r) == ""
    assert "needs a model parameter 15.9 standard deviations off" in bent(np.array([0.3, -15.9]), r)
    strained = replace(r, nothing=empty(15.5))
    assert bent(np.array([0.3, -15.9]), strained) == ""
    assert bent(np.array([0.3, -16.9]), strained) != ""


def test_a_choice_that_leaves_the_model_nearer_on_the_whole_does_not_bend_it():
    """One number may go further where the others come back: what else is missing still pulls at it."""
    r = ruling(candidate("law", 900, 400))
    strained = replace(r, nothing=replace(r.nothing, point=replace(r.nothing.point, theta=np.array([12.0, 12.0]))))
    assert bent(np.array([0.3, -16.9]), strained) == ""
    assert bent(np.array([3.0, -16.9]), strained) != ""


def test_where_the_model_is_strained_a_loss_on_selection_is_weighed_against_the_gain():
    """The owner's statement, not the selection runs, speaks against a strained constant."""
    assert ruling(candidate("parameter_change", 94, -6.7, family="gain"), theta=6.8).accepted
    assert not ruling(candidate("parameter_change", 94, -20, family="gain"), theta=6.8).accepted
    assert not ruling(candidate("parameter_change", 94, -6.7, family="gain"), theta=1.0).accepted


@pytest.mark.parametrize(("behind", "first"), [(0.0005, "short"), (0.01, "long")])
def test_no_law_is_trusted_to_a_thousandth_of_what_it_explains(behind, first):
    """At a very high signal-to-noise ratio the form of a law decides, not its name: the shorter one is told first."""
    gain = 1e6
    costs = 1e-3 * np.random.default_rng(5).standard_normal(60)
    long = candidate("long", gain, gain / 2, values=(1.0, 1.0), family="offset")
    short = candidate("short", gain * (1 - behind), gain / 2, family="force", blocks=long.blocks - 500 + 1.5 * gain / 60 + costs)
    r = judge(NOISE, [replace(empty(), train=2 * gain, select=gain), *(replace(c, train=2 * gain + c.train - 20000, select=gain + c.select - 10000) for c in (long, short))], FEW, SAMPLES)
    assert r.rivals[0].candidate.hypothesis.physics == first
    assert {x.candidate.hypothesis.physics for x in r.rivals} == ({"short", "long"} if first == "short" else {"long"})


def test_what_costs_more_by_the_same_everywhere_is_surely_worse():
    """As a simulation does that leaves: every block costs the same huge number."""
    good = np.linspace(400, 600, 60)
    assert separation(np.full(60, 1e30), np.full(60, 500.0)) == np.inf
    assert separation(np.full(60, 1e30), good) == np.inf
    assert separation(good, good) == 0.0
    assert separation(good, good, -1.0) == -np.inf


def rivals_of(*told: tuple[dict[str, str], float]) -> Step:
    """Return a step whose rivals have these notes and weights."""
    listed = []
    for notes, weight in told:
        c = candidate("mode", 100, 50)
        listed.append(Rival(replace(c, hypothesis=replace(c.hypothesis, notes=notes)), 0.0, 0.0, weight))
    return Step(replace(ruling(candidate("mode", 100, 50)), rivals=tuple(listed)), 1.0)


def test_two_shapes_of_one_thing_are_one_name():
    own, other, shape = {"variant": "damping"}, {"variant": "stiffness"}, {"variant": "damping with its couplings", "of": "damping"}
    step = rivals_of((own, 0.3), (other, 0.2), (shape, 0.5))
    assert [(r.candidate.key, r.weight) for r in _told(step)] == [("mode@input:a#damping", pytest.approx(0.8)), ("mode@input:a#stiffness", pytest.approx(0.2))]


def test_another_shape_of_the_plain_law_is_the_plain_law():
    step = rivals_of(({}, 0.4), ({"variant": "turned", "of": ""}, 0.6))
    assert [(r.candidate.key, r.weight) for r in _told(step)] == [("mode@input:a", pytest.approx(1.0))]


def test_of_every_constant_that_may_have_changed_the_best_way_is_looked_at():
    """A second way of one constant may not push another constant out of the few that are looked at."""
    ways = [("stiffness", "with its couplings", 10.0), ("stiffness", "", 11.0), ("damping", "", 12.0), ("mass", "", 13.0)]
    found = []
    for name, variant, cost in ways:
        h = candidate(CHANGE).hypothesis
        h = replace(h, notes={"variant": f"{name} {variant}".strip(), "of": name}, parameters=(replace(h.parameters[0], name=name),))
        found.append((cost, h, Point(np.zeros(0), ())))
    assert [(cost, h.notes["variant"]) for cost, h, _ in _one_way_each(found)] == [
        (10.0, "stiffness with its couplings"), (12.0, "damping"), (13.0, "mass"),
    ]


def test_a_constant_that_took_back_what_others_had_absorbed_is_settled_wherever_it_stands():
    found = [(100.0 + k, candidate(f"law{k}").hypothesis, Point(np.zeros(1), ())) for k in range(SETTLED + 4)]
    last = found[-1][1].key
    near, far = _promising(found, {last})
    assert [h.key for _, h, _ in near] == [*(h.key for _, h, _ in found[:SETTLED]), last]
    assert [h.key for _, h, _ in far] == [h.key for _, h, _ in found[SETTLED:-1]]
