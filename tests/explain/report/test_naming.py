"""Parameters of names: their standard deviations are those of a regression, their units those of people."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from afdsvc.api.physics import Coefficient, Hypothesis, Signal
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.report.explanation import Estimate
from afdsvc.explain.report.naming import _estimate, _named, _own_of, _shape, _why, estimates, offsets
from afdsvc.explain.report.report import _offsets
from afdsvc.explain.search.build import build
from afdsvc.explain.search.fit import fit
from afdsvc.explain.search.ranking import Candidate
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.effects import PlacedEffect
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.explain.verdict.verdict import Claim

NOISE = 0.02


def cubic(p, z, m, dt, out):
    """A hardening spring."""
    out[0] -= p[0] * z[0] ** 3


def law(low: float, linear: bool) -> Hypothesis:
    q, v = Signal("x", 0), Signal("x", 1)
    size = Coefficient("stiffness", "N/mm^3", low, 1e6, 100.0, linear=linear, through=(1, 0))
    return Hypothesis("cubic", "state:v", "spring", "force", cubic, (q,), (v,), (size,), ((500.0,),))


def test_parameters_of_a_look_alike_are_its_own_where_another_effect_comes_after_it(spring, recorded):
    problem = build(nominal(spring, 2e-3), prepare(spring, [recorded(1)]), Settings())
    first, second = law(-1e6, True), replace(law(-1e6, True), physics="other", parameters=(Coefficient("width", "", -1.0, 1.0, 0.1, linear=True),))
    point = problem.start().added(PlacedEffect(first, np.array([300.0]))).added(PlacedEffect(second, np.array([0.5])))
    candidate = Candidate(first, {0.0: fit(problem, point, 0.0, 1.0, iterations=0)}, None)  # type: ignore[arg-type]
    assert _own_of(problem, candidate, 0.0).keys() == {"stiffness"}


def test_shapes_of_one_name_are_told_apart_where_both_are_listed():
    shapes = [replace(law(-1e6, True), notes={"variant": variant, "of": variant}) for variant in ("soft", "stiff")]
    claims = [Claim(Candidate(h, {}, None), 0.5, 1, 0.9) for h in (*shapes, replace(shapes[0], physics="other"))]  # type: ignore[arg-type]
    assert [_shape(c.candidate.hypothesis, claims) for c in claims] == ["soft", "stiff", ""]
    assert _shape(shapes[0], claims[:1]) == ""
    assert "left out, soft (" in _named(claims[0], {"k": Estimate(1.0, None, "N")}, 2, False, {"cubic": "a spring left out"}, "soft").sentence


@pytest.mark.parametrize(("low", "linear"), [(-1e6, True), (0.0, False)])
def test_standard_deviations_are_those_of_a_regression_in_the_unit_of_the_input(spring, recorded, low, linear):
    """A plant known exactly: the deviation is noise over the norm of the output's derivative, on either scale of the search."""
    exact = replace(spring, entry_sd={name: np.zeros(getattr(spring.plant, name).shape) for name in "ABCD"})
    runs = prepare(exact, [recorded(k, extra=lambda q, v: -600.0 * q**3, noise=NOISE) for k in (1, 2)])
    problem = replace(build(nominal(exact, runs[0].dt), runs, Settings()), offset_free=False)
    start = problem.start()
    found = fit(problem, start.added(PlacedEffect(law(low, linear), np.array([500.0]))), 0.0, 1.0)
    (reported,) = estimates(problem, found, 0.0)
    value = found.point.effects[0].values[0]
    derivative = []
    for h in (1.0, -1.0):
        moved = replace(found.point, effects=(PlacedEffect(law(low, linear), np.array([value + h])),))
        derivative.append(np.vstack([s.y for s in problem.simulated(moved, 0.0)]))
    expected = NOISE / np.linalg.norm((derivative[0] - derivative[1]) / 2)
    assert reported["stiffness"].unit == "N/mm^3"
    assert reported["stiffness"].value == pytest.approx(value / 1e4)
    assert reported["stiffness"].value == pytest.approx(0.06, abs=4 * reported["stiffness"].sd)
    assert reported["stiffness"].sd == pytest.approx(expected / 1e4, rel=0.15)


@pytest.mark.parametrize(("unsigned", "value"), [(True, 0.06), (False, -0.06)])
def test_what_opposes_the_motion_is_positive_though_the_input_acts_against_the_axis(unsigned, value):
    c = replace(law(0.0, True).parameters[0], unsigned=unsigned)
    found = _estimate(600.0, c, 10.0, np.array([[0.0], [-1e4]]))
    assert (found.value, found.sd) == (pytest.approx(value), pytest.approx(1e-3))


def test_what_the_recordings_say_nothing_about_has_no_deviation(spring, recorded):
    runs = prepare(spring, [recorded(1)])
    problem = build(nominal(spring, runs[0].dt), runs, Settings())
    h = law(-1e6, True)
    blind = replace(h, parameters=(*h.parameters, Coefficient("nothing", "", -1.0, 1.0, 0.1)), starts=((0.0, 0.0),))
    (reported,) = estimates(problem, fit(problem, problem.start().added(PlacedEffect(blind, np.zeros(2))), 0.0, 1.0), 0.0)
    assert reported["nothing"].sd is None
    assert reported["stiffness"].sd is not None


@pytest.mark.parametrize(("shift", "said"), [(0.0, 0), (0.005, 0), (0.3, 1)])
def test_the_zero_of_a_reading_that_was_fitted_is_said(spring, recorded, shift, said):
    """Its deviation is that of a mean, beside numbers of the model that a shift does not touch; what is small beside the noise is not worth a sentence."""
    moved = [replace(t, values=t.values + np.array([0.0, shift])) for t in (recorded(k, noise=NOISE) for k in (1, 2))]
    runs = prepare(spring, moved)
    problem = build(nominal(spring, runs[0].dt), runs, Settings())
    found = fit(problem, problem.start(), 0.0, 1.0)
    (zero,) = offsets(problem, found, 0.0)
    assert zero.value == pytest.approx(shift, abs=5 * zero.sd)
    assert zero.sd == pytest.approx(NOISE / np.sqrt(sum(map(len, runs))), rel=0.2)
    sentences = list(_offsets(problem, found, 0.0))
    assert len(sentences) == said
    assert all(s.startswith("a constant offset 0.") and "mm of the reading position" in s for s in sentences)


def test_why_the_first_of_a_round_is_not_claimed_is_not_compared_with_itself():
    first, second = (SimpleNamespace(hypothesis=SimpleNamespace(title=n), evidence=SimpleNamespace(explained=x)) for n, x in (("friction", 0.82), ("play", 0.79)))
    step = SimpleNamespace(candidates=[first, second], accepted=True, reason="", worse=())
    assert _why(first, step).startswith("closes 82 % of the gap on left-out blocks, but is not claimed")
    assert _why(second, step) == "closes 79 % of the gap on left-out blocks; friction closes 82 %"
    apart = SimpleNamespace(candidates=[first], accepted=True, reason="", worse=(second,))
    assert "followed worse with it than with friction" in _why(second, apart)
