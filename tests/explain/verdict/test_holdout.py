"""What the recordings held out do to names: doubted where they do not improve, withdrawn where they do worse."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom

from afdsvc.api.model import Model, Variable
from afdsvc.api.physics import LONG_AGO, Coefficient, Hypothesis, Signal
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.search.build import build
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.effects import PlacedEffect
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.explain.verdict import holdout as module
from afdsvc.explain.verdict.holdout import HeldOutVerdict, Player, _without
from afdsvc.explain.verdict.verdict import Claim, Verdict
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.parameter_step import stepping


@pytest.fixture
def final(monkeypatch):
    """Return what is judged of one claim of weight 1, with these errors of the three models on the recordings held out.

    ``present``: a flexible model predicts the residual; ``even``: residuals are not weighted; ``measured``: the noise is known; ``sure``: that the weighted error falls.
    """
    return lambda *errors, present=True, even=True, sure=None, attempt=1, measured=False: _judged(monkeypatch, *errors, present, even, sure, attempt, measured)


def _judged(
    monkeypatch, stated: float, refitted: float, error: float, present: bool, even: bool, sure: float | None, attempt: int, measured: bool
) -> HeldOutVerdict:
    points = {name: SimpleNamespace(name=name, effects=()) for name in ("stated", "refitted", "final")}
    errors = {"stated": stated, "refitted": refitted, "final": error}
    hypothesis = SimpleNamespace(key="law@input:u", title="law (input u)", family="", physics="law")
    found = SimpleNamespace(
        problem=SimpleNamespace(
            start=lambda: points["stated"], settings=Settings(), weighting=SimpleNamespace(even=even, measured=measured)
        ),
        start={0.0: SimpleNamespace(point=points["refitted"], tau=1.0)}, end={0.0: SimpleNamespace(point=points["final"])},
    )
    better = lambda runs, before, after: float(errors[after.name] < errors[before.name]) if sure is None else sure  # noqa: E731
    play = SimpleNamespace(nrmse=lambda runs, point: np.array([errors[point.name]]), better=better)
    monkeypatch.setattr(module, "player", lambda problem, last: play)
    monkeypatch.setattr(module, "fit", lambda problem, point, *a, **k: SimpleNamespace(point=point))
    claim = Claim(SimpleNamespace(hypothesis=hypothesis), 1.0, 1, 0.5)
    verdict = Verdict("omitted_physics", (claim,), ("closes 50 % of the gap",), SimpleNamespace(present=present, total=0.02, sentence="the gap"), None, (0.5, 0.1))
    return module.checked_on_holdout(found, verdict, [], attempt)


@pytest.mark.parametrize(
    ("stated", "refitted", "error", "weight"),
    [(0.5, 0.4, 0.2, 1.0), (0.5, 0.4, 0.42, 0.5), (5.0, 4.0, 2.0, 0.5), (0.3, 0.5, 0.2, 1.0), (0.3, 0.5, 0.32, 0.5)],
)
def test_a_name_is_certain_only_where_the_recordings_held_out_are_followed_better(final, stated, refitted, error, weight):
    answer = final(stated, refitted, error)
    verdict = answer.verdict
    assert answer.unconfirmed is (error > min(stated, refitted))
    assert [c.weight for c in verdict.claims] == [weight]
    assert (weight < 1) == any("no name is certain" in s for s in verdict.sentences)
    assert not any("only the recordings held out show" in s for s in verdict.sentences)


@pytest.mark.parametrize(("stated", "refitted"), [(0.2, 0.2), (0.2, 0.5), (0.5, 0.2)])
def test_a_name_that_does_worse_than_the_model_without_it_is_refuted(final, stated, refitted):
    answer = final(stated, refitted, 0.3)
    assert answer.unconfirmed
    assert answer.verdict.verdict == "unexplained"
    assert not answer.verdict.claims
    gap, why = answer.verdict.sentences  # what a name that is not claimed closes is not said
    assert gap == "the gap"
    assert why.endswith("nothing is claimed")
    assert not final(0.5, 0.4, 0.2).unconfirmed


def test_a_name_against_the_gap_test_and_the_recordings_held_out_is_not_claimed(final):
    """Noise that is known shows a gain; the gap test sees nothing, and the model without the name follows what was held out better."""
    for error, claimed in ((0.41, False), (0.3, True)):
        assert bool(final(0.5, 0.4, error, present=False, measured=True).verdict.claims) is claimed
    assert final(0.5, 0.4, 0.41, measured=True).verdict.claims


@pytest.mark.parametrize(("present", "even"), [(False, True), (True, False)])
def test_what_only_the_search_sees_is_claimed_where_the_recordings_held_out_show_it(final, present, even):
    """No flexible model predicts the residual, or slow noise had to be divided out: the name rests on the search alone."""
    shown, not_shown = (final(0.5, 0.4, error, present=present, even=even).verdict for error in (0.2, 0.45))
    assert [c.weight for c in shown.claims] == [0.8]
    assert shown.sentences[-1].endswith("only the recordings held out show that there is a gap: no name is certain")
    assert not not_shown.claims
    assert not_shown.verdict == ("unexplained" if present else "consistent")
    assert not final(0.5, 0.4, 0.405, present=present, even=even, sure=1.0).verdict.claims  # the weighted error falls, the plain one does not


def test_the_more_names_were_tried_the_likelier_one_must_be(final):
    """Bonferroni: 0.5 for the first name, 0.75 for the second; what is not confirmed gives way to another name where there is a gap."""
    once, twice = (final(0.5, 0.4, 0.2, even=False, sure=0.6, attempt=k) for k in (1, 2))
    assert [c.weight for c in once.verdict.claims] == [0.6]
    assert not once.unconfirmed
    assert not twice.verdict.claims


def test_better_in_every_block_is_sure_and_in_half_of_them_is_not(monkeypatch):
    rng, n = np.random.default_rng(1), 4000
    noise, missed = rng.standard_normal((n, 1)), np.sin(np.arange(n) / 9.0)[:, None]
    problem = SimpleNamespace(weighting=lambda e: e, scale=np.ones(1), settings=Settings())
    simulated = {"before": -noise - missed, "after": -noise, "another": -rng.standard_normal((n, 1)) - missed, "left": np.full((n, 1), np.nan)}
    monkeypatch.setattr(Player, "outputs", lambda self, runs, point: [simulated[point]])
    monkeypatch.setattr(module, "moments", lambda point: [])
    runs = [type("Recording", (), {"Y": np.zeros((n, 1)), "__len__": lambda self: n})()]
    play = Player(problem, "from the inputs", 0.0)
    assert play.better(runs, "before", "after") > 0.999
    assert play.better(runs, "before", "another") < 0.95
    assert play.better(runs, "before", "left") == 0.0


def _short(monkeypatch, before, after, moments=()):
    """Return how sure it is that ``after``, with changes at ``moments``, is better, both errors ``(n, 1)``, in one recording of two blocks."""
    monkeypatch.setattr(module, "moments", lambda point: moments if point == "after" else ())
    problem = SimpleNamespace(weighting=lambda e: e, scale=np.ones(1), settings=Settings())
    simulated = {"before": -before, "after": -after}
    monkeypatch.setattr(Player, "outputs", lambda self, runs, point: [simulated[point]])
    run = type("Recording", (), {"Y": np.zeros((len(before), 1)), "__len__": lambda self: len(before)})()
    return Player(problem, "from the inputs", 0.0).better([run], "before", "after")


def test_an_error_five_times_smaller_is_sure_in_a_recording_of_two_blocks(monkeypatch):
    """A t-test of two blocks has one degree of freedom; the F-test counts independent samples."""
    rng, n = np.random.default_rng(2), 160
    slow, uneven = np.linspace(-1.0, 1.0, n)[:, None], np.repeat([0.01, 0.15], n // 2)[:, None]
    assert _short(monkeypatch, slow, uneven * rng.standard_normal((n, 1))) > 0.95


def test_a_moment_sought_in_the_recording_counts_as_many_tests(monkeypatch):
    """One error twice as small, in power, than another of the same colour."""
    rng, n = np.random.default_rng(6), 200
    one, other = (rng.standard_normal((n, 1)) for _ in range(2))
    plain, sought = (1 - _short(monkeypatch, np.sqrt(2.0) * one, other, moments) for moments in ((), ((0, 1),)))
    assert 0 < plain < 1e-3
    assert sought == pytest.approx(module.MOMENTS * plain, rel=1e-6)


RINGING = np.poly(np.exp([-1 / 100 + 0.1j, -1 / 100 - 0.1j])).real  # of a resonance that noise drives, for 100 samples


@pytest.mark.parametrize(("colour", "n"), [([1.0, -0.8], 200), (RINGING, 1000)])
def test_models_that_follow_short_recordings_alike_rarely_seem_different(monkeypatch, colour, n):
    """Independent errors of one colour, 400 times: surer than 95 % in 5 % at most, up to the 99.9 % bound of the count."""
    rng, sure = np.random.default_rng(3), 0
    for _ in range(400):
        errors = [lfilter([1.0], colour, rng.standard_normal((2 * n, 1)), axis=0)[n:] for _ in range(2)]
        sure += _short(monkeypatch, *errors) > 0.95
    assert sure <= binom.ppf(0.999, 400, 0.05)


def hardening(p, z, m, dt, out):
    """A cubic spring."""
    out[0] -= p[0] * z[0] * z[0] * z[0]


def test_a_machine_that_began_at_rest_is_played_from_rest_with_a_law_its_model_lacks():
    """Without the law, the initial state that fits the beginning best makes up for it: 19 mm where the axis was at 0."""
    rng, dt, fine = np.random.default_rng(1), 0.005, 100
    u, x, v, y = np.repeat(rng.uniform(-15, 15, 401), 20)[:8000], 0.0, 0.0, np.empty(8000)
    for k in range(8000):
        y[k] = x
        for _ in range(fine):
            v += dt / fine * (500 * u[k] - 4 * v - 400 * x - 1.25 * x**3)
            x += dt / fine * v
    plant = StateSpace(np.array([[0, 1.0], [-400, -4]]), np.array([[0.0], [500]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
    model = Model("axis", (Variable("force", "N"),), (Variable("position", "mm"),), (Variable("x", "mm"), Variable("v", "mm/s", "x")), plant)
    trace = Trace("axis", dt, (Channel("u_force", "N"), Channel("y_position", "mm")), np.column_stack([u, y + 0.03 * rng.standard_normal(8000)]))
    runs = prepare(model, [trace])
    problem = build(nominal(model, dt), runs, Settings())
    size = Coefficient("stiffness", "", 0.0, np.inf, 1.0)
    law = Hypothesis("hardening", "state:v", "stiffness", "force", hardening, (Signal("x", 0),), (Signal("x", 1),), (size,), ((1.0,),))
    point = problem.start().added(PlacedEffect(law, np.array([1.25])))
    (simulated,), (x0,) = module.played_back(problem, point)
    assert abs(problem.x0[0][0]) > 5
    assert np.std(runs[0].Y - simulated) < 0.1
    assert abs(x0[0]) < 0.1


@pytest.mark.parametrize("fails", [-100.0, 7.3, np.inf])
@pytest.mark.parametrize("memory", [0, 2])  # in one recording: what comes before it is undone
def test_a_change_comes_in_a_recording_held_out_where_it_shows_or_before_or_after(fails, memory):
    """The gain falls by 40 % and takes 2 s to do so; in what was fitted it did at 3 s."""
    rng, dt, n = np.random.default_rng(4), 0.01, 1500
    share = np.clip((dt * np.arange(n) - fails) / 2.0 + 0.5, 0.0, 1.0)
    u = np.repeat(rng.normal(size=n // 10), 10)
    y = lfilter([0, 1 - np.exp(-4 * dt)], [1, -np.exp(-4 * dt)], u * (1 - 0.4 * share * share * (3 - 2 * share)))
    motor = Model("motor", (Variable("u"),), (Variable("y"),), (Variable("x"),), StateSpace.of([[-4.0]], [[4.0]], [[1.0]]))
    runs = prepare(motor, [Trace("held", dt, (Channel("u_u"), Channel("y_y")), np.column_stack([u, y]))])
    problem = build(nominal(motor, dt), runs, Settings())
    numbers = Coefficient("gain", "", -1.0, 1.0, 0.1), Coefficient("moment", "s", 1.0, 9.0, 1.0, later=LONG_AGO), Coefficient("takes", "s", 2.0, 2.0, 1.0), Coefficient("nominal", "", 1.0, 1.0, 1.0)
    law = Hypothesis("step", "input:u", "drift", "input", stepping, (Signal("u", 0), Signal("t")), (Signal("u", 0),), numbers, ((0.0, 5.0, 2.0, 1.0),), memory=memory)
    point = problem.start().added(PlacedEffect(law, np.array([-0.4, 3.0, 2.0, 1.0])))
    assert Player(problem, "from the inputs", 0.0).nrmse(runs, point)[0] < 6e-3


@pytest.mark.parametrize(("physics", "compared"), [("parameter_change", "stated"), ("coulomb_friction", "better of the two")])
def test_a_changed_number_is_compared_with_the_model_as_stated(physics, compared):
    """The refit has that change, too."""
    hypothesis = SimpleNamespace(key=physics, physics=physics, family="")
    verdict = SimpleNamespace(claims=(SimpleNamespace(candidate=SimpleNamespace(hypothesis=hypothesis)),))
    found = SimpleNamespace(problem=SimpleNamespace(start=lambda: "stated"))
    assert _without(found, verdict, "better of the two") == compared
