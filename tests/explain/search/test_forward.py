"""The search on a motor whose speed is measured, with and without dry friction simulated by code of its own."""

import importlib.util
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from afdsvc.api.physics import Hypothesis
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.search import forward
from afdsvc.explain.search.base import settled
from afdsvc.explain.search.build import build
from afdsvc.explain.search.evidence import HypothesisEvidence, block_spans, noise_times, refitted
from afdsvc.explain.search.fit import Coordinates, fit, priced, weighted
from afdsvc.explain.search.forward import search
from afdsvc.explain.search.machine import hypotheses, machine
from afdsvc.explain.search.ranking import Candidate, look_alikes, mechanism, vote_shares
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.plugins.physics.actuator_lag import ActuatorLag
from afdsvc.plugins.physics.coulomb_friction import CoulombFriction
from afdsvc.plugins.physics.dead_zone import DeadZone
from afdsvc.plugins.physics.parameter_change import ParameterChange
from afdsvc.plugins.physics.sensor_lag import SensorLag
from afdsvc.plugins.physics.sensor_offset import SensorOffset

_spec = importlib.util.spec_from_file_location("motor", Path(__file__).parents[1] / "motor.py")
motor = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(motor)
LIBRARY = [CoulombFriction(), DeadZone(), SensorLag()]


def problem(friction, seeds=(1, 2), noise=1.0, factor=1.0):
    model = motor.model()
    runs = prepare(model, [motor.recording(friction, s, noise=noise, name=f"r{s}") for s in seeds])
    return build(nominal(model, runs[0].dt), runs, Settings())


@pytest.fixture(scope="module")
def said():
    return []


@pytest.fixture(scope="module")
def found(said):
    return search(settled(problem(60.0)), LIBRARY, progress=lambda what, share: said.append((what, share)))


def test_progress_moves_with_every_hypothesis_and_never_back(found, said):
    whats, shares = zip(*said, strict=True)
    assert all(np.diff(shares) >= 0)
    assert max(shares) <= 1.0
    offered = sum(what.startswith("round 1, screening") for what in whats) / 2  # at both ends of the horizons
    assert f"round 1, screening {offered:.0f} of {offered:.0f}" in whats
    for what in ("trying 1 of", "fitting 1 of", "fitting whole recordings 1 of", "leaving out blocks 1 of"):
        assert any(w.startswith(f"round 1, {what}") for w in whats)


def test_dry_friction_is_found_where_only_speed_is_measured(found):
    first = found.steps[0]
    assert first.accepted
    assert first.candidates[0].hypothesis.physics == "coulomb_friction"
    effect = found.end[0.0].point.effects[-1]
    assert effect.values[0] == pytest.approx(60.0, rel=0.1)  # rpm/s, as simulated


@pytest.mark.parametrize("decisive", [True, False])
def test_a_law_that_ends_at_the_limit_of_what_it_means_is_not_compared(decisive):
    """Friction of 60 rpm/s where 30 are the most that may be meant."""

    class Limited(CoulombFriction):
        def hypotheses(self, machine):
            h = next(iter(super().hypotheses(machine)))
            return [replace(h, parameters=(replace(h.parameters[0], high=30.0, decisive=decisive), *h.parameters[1:]))]

    candidates = search(settled(problem(60.0)), [Limited(), SensorLag()]).steps[0].candidates
    assert ("coulomb_friction" in {c.hypothesis.physics for c in candidates}) != decisive


def test_a_law_that_ends_there_once_its_fit_converged_is_not_accepted(monkeypatch):
    """Compared while it was short of the limit, it goes on to it as it is accepted."""
    asked = []
    monkeypatch.setattr(forward, "_ended", lambda path: asked.append(path) or len(asked) > 1)  # the first shape is compared, the others are not, and what was accepted ends there
    steps = search(settled(problem(60.0)), [CoulombFriction()], better=lambda *paths: 1.1).steps
    assert [s.accepted for s in steps] == [False]
    assert "ends at the limit of what it means" in steps[0].reason


def test_samples_count_by_what_the_best_hypothesis_leaves(found):
    """Friction that is missing makes the residual correlated for longer than the noise; the fits with it do not count by that."""
    start, first, end = found.start[0.0], found.steps[0].candidates[0].fit, found.end[0.0]
    assert start.tau > 2 * end.own_tau
    assert first.tau == pytest.approx(first.own_tau, rel=0.2)
    assert end.tau == pytest.approx(end.own_tau, rel=0.2)


@pytest.mark.parametrize(("force", "rounding", "paid"), [(100.0, 2.0, 2), (100.0, 0.5, 1), (0.5, 0.5, 1)])
def test_a_nuisance_that_the_recordings_say_nothing_of_costs_nothing(found, force, rounding, paid):
    end = found.end[0.0]
    information = np.diag([1.0] * (end.shared - 2) + [force, rounding])
    assert priced(found.problem, replace(end, H=information), end.point.effects[-1].hypothesis) == paid


def test_its_weight_counts_resampled_blocks(found):
    alike = look_alikes(found.steps[0].candidates, Settings())
    w = vote_shares(alike, Settings(), found.limited)
    assert w.sum() == pytest.approx(1.0)
    friction = sum(x for x, c in zip(w, alike, strict=True) if c.hypothesis.physics == "coulomb_friction")
    assert friction > 0.9  # its variants share the vote: while the motor moves they are one force


@pytest.mark.parametrize(
    ("friction", "reason"), [(0.0, "no hypothesis of the library gains anything"), (15.0, "coulomb friction (force on speed): gain at the decision horizon")]
)
def test_nothing_is_accepted_from_coloured_noise_alone(friction, reason):
    """Nor friction so small that the noise hides it."""
    found = search(settled(problem(friction, noise=8.0)), LIBRARY)
    assert not any(s.accepted for s in found.steps)
    assert found.steps[0].reason.startswith(reason)
    assert ("expected more than" in found.steps[0].reason) == (friction > 0)


def test_an_offset_is_no_effect_and_comes_last():
    model = motor.model()
    traces = [motor.recording(60.0, s, name=f"r{s}") for s in (1, 2)]
    shifted = [replace(t, values=t.values + np.array([0.0, 200.0])) for t in traces]
    settings = replace(Settings(), effects=1)
    found = search(settled(build(nominal(model, motor.DT), prepare(model, shifted), settings)), [*LIBRARY, SensorOffset()])
    accepted = [s.candidates[0].hypothesis.physics for s in found.steps if s.accepted]
    assert accepted == ["coulomb_friction", "sensor_offset"]
    assert found.effects == 1
    values = {e.hypothesis.physics: e.values[0] for e in found.end[0.0].point.effects}
    assert values["coulomb_friction"] == pytest.approx(60.0, rel=0.1)
    assert values["sensor_offset"] + found.end[0.0].point.offset[0] == pytest.approx(200.0, rel=0.05)


def test_errors_of_coarse_steps_are_no_further_effect(found, monkeypatch):
    """A lag is simulated in finer steps than friction: where the noise is small, it stood for the error of the friction's reversals."""
    assert found.problem.substeps == 1  # the noise hides it
    library = [CoulombFriction(), ActuatorLag()]
    fine = search(settled(problem(60.0, seeds=(1,), noise=0.03)), library)
    assert [s.candidates[0].hypothesis.physics for s in fine.steps if s.accepted] == ["coulomb_friction"]
    assert fine.problem.substeps == forward.FINER
    monkeypatch.setattr(forward, "coarse", lambda problem, path: False)
    coarse = search(settled(problem(60.0, seeds=(1,), noise=0.03)), library)
    assert [s.candidates[0].hypothesis.physics for s in coarse.steps if s.accepted] == ["coulomb_friction", "actuator_lag"]
    assert fine.end[0.0].deviance < coarse.steps[0].candidates[0].fit.deviance


@pytest.mark.parametrize("confirms", [True, False])
@pytest.mark.parametrize(("strict", "reason"), [({"sure": 1.0}, "share of resampled blocks"), ({"sure": 1.0, "chance": 1e9}, "gain of likelihood")])
def test_what_chance_and_resampled_blocks_doubt_the_recordings_held_out_decide(confirms, strict, reason):
    unanimous = replace(problem(60.0), settings=replace(Settings(), **strict))  # no share of resamplings is more than all of them
    asked = []

    def better(problem, before, after):
        asked.append(after[0.0].cost < before[0.0].cost)
        return 1.1 if confirms else 0.9

    found = search(settled(unanimous), LIBRARY, better=better)
    assert asked == [True] * (1 + confirms)  # an accepted name is compared with a look-alike, too
    assert found.steps[0].accepted == confirms
    assert reason in found.steps[0].reason


def test_where_noise_limits_what_chance_may_promise_is_not_accepted():
    """Its size is known there, and recordings held out add nothing to that."""
    base = settled(replace(problem(60.0), settings=replace(Settings(), chance=1e9)))
    found = search(replace(base, limited="noise"), LIBRARY, better=lambda problem, before, after: 1.1)
    assert not found.steps[0].accepted
    assert "gain of likelihood" in found.steps[0].reason


def test_a_further_effect_that_recordings_held_out_follow_worse_is_not_accepted():
    model = motor.model()
    traces = [motor.recording(60.0, s, name=f"r{s}") for s in (1, 2)]
    late = [replace(t, values=np.column_stack([t.values[:, 0], np.roll(t.values[:, 1], 5)])) for t in traces]
    base = settled(build(nominal(model, motor.DT), prepare(model, late), Settings(effects=2)))
    both, one = (search(base, LIBRARY, better=lambda problem, before, after, sure=sure: sure) for sure in (0.5, 0.0))
    assert (both.effects, one.effects) == (2, 1)
    assert [s.confirmed for s in both.steps if s.accepted] == [1.0, 0.5]  # the first is compared with the model, in the verdict
    assert any("recordings held out" in s.reason for s in one.steps[1:])

    def without(problem, before, after):
        return 0.9 if len(after[0.0].point.effects) < len(before[0.0].point.effects) else 0.5

    dropped = search(base, LIBRARY, better=without)
    assert dropped.effects == 1  # the last one is for the verdict to judge
    assert "better without it" in dropped.steps[1].reason


@pytest.mark.parametrize("in_doubt", [True, False])
def test_where_recordings_held_out_refute_a_further_effect_the_next_that_is_in_no_doubt_is_tried(monkeypatch, in_doubt):
    model = motor.model()
    late = [replace(t, values=np.column_stack([t.values[:, 0], np.roll(t.values[:, 1], 5)])) for t in (motor.recording(60.0, s, name=f"r{s}") for s in (1, 2))]
    decided, first = forward._decided, []

    def seen(ranked, limited, rounds, by_chance, further):
        step = decided(ranked, limited, rounds, by_chance, further)
        first.extend([mechanism(ranked[0].hypothesis)] if further and not first else [])
        return replace(step, reason="in doubt" if in_doubt else "") if further and mechanism(ranked[0].hypothesis) in first else step

    def better(problem, before, after):
        return 0.0 if first and mechanism(after[0.0].point.effects[-1].hypothesis) in first else 0.5

    monkeypatch.setattr(forward, "_decided", seen)
    found = search(settled(build(nominal(model, motor.DT), prepare(model, late), Settings(effects=2))), [*LIBRARY, ActuatorLag()], better=better)
    refuted = next(s for s in found.steps if not s.accepted and mechanism(s.candidates[0].hypothesis) in first)
    instead = next(s for s in found.steps[1:] if s.accepted)
    assert ("in doubt" if in_doubt else "recordings held out") in refuted.reason
    assert first[0] not in [mechanism(c.hypothesis) for c in instead.candidates]
    assert not instead.reason
    assert found.effects == 2


@pytest.mark.parametrize("sure", [0.9, 1.0])
def test_a_look_alike_that_recordings_held_out_are_surely_followed_worse_with_is_not_named(sure):
    """A lag of the drive and one of the sensor are the same in an open loop."""
    model = motor.model()
    traces = [motor.recording(0.0, s, noise=0.3, name=f"r{s}") for s in (1, 2)]
    lagging = [replace(t, values=np.column_stack([t.values[:, 0], lfilter([0.2], [1, -0.8], t.values[:, 1])])) for t in traces]

    def better(problem, before, after):
        fewer = len(after[0.0].point.effects) < len(before[0.0].point.effects)
        return 0.5 if not before[0.0].point.effects or fewer else sure

    base = settled(build(nominal(model, motor.DT), prepare(model, lagging), Settings(effects=1)))
    step = search(base, [ActuatorLag(), SensorLag()], better=better).steps[0]
    assert step.accepted
    first, both = step.candidates[0].hypothesis.physics, {"sensor_lag", "actuator_lag"}
    assert {c.hypothesis.physics for c in look_alikes(step.candidates, Settings())} == (both if sure < 0.95 else {first})
    assert {c.hypothesis.physics for c in step.worse} == (set() if sure < 0.95 else both - {first})


@pytest.mark.parametrize(("lengths", "kept"), [((4000,) * 10, (2500, 1, 1, 2500, 1, 1, 2500, 1, 1, 2500)), ((9000, 600), (9000, 600)), ((15000, 5000), (7500, 2500)), ((400,) * 9 + (9000,), (392, 1, 1, 392, 1, 1, 392, 1, 1, 8823))])
def test_four_recordings_stand_for_many_that_are_long(lengths, kept):
    p = problem(0.0, seeds=(1,))
    one = p.runs[0]
    long = [replace(one, U=np.resize(one.U, (n, 1)), Y=np.resize(one.Y, (n, 1)), AUX=np.zeros((n, 0)), REF=np.zeros((n, 1)), taken=None) for n in lengths]
    parts = p.of(long, p.x0[:1] * len(long)).beginning()
    assert [len(r) for r in parts.runs] == list(kept)
    assert len(parts.x0) == len(lengths)


@pytest.mark.parametrize("limited", ["model", "noise"])
def test_tones_are_looked_for_whatever_limits(limited):
    model, tone = motor.model(), 40.0
    t = motor.recording(60.0, 1, name="r")
    humming = replace(t, values=np.column_stack([t.values[:, 0], t.values[:, 1] + 30 * np.sin(tone * t.dt * np.arange(len(t)))]))
    p = build(nominal(model, motor.DT), prepare(model, [humming]), Settings())
    found = forward._seen(p, settled(p).start, limited).tones
    assert any(abs(w - tone) < 0.5 for w in found)


def test_the_gain_of_a_sensor_is_no_reason_where_a_predictor_is_corrected():
    base = settled(problem(0.0))
    seen = machine(base.problem, list(base.start.values())[-1], 0.0)
    stages = [[h.stage for h in hypotheses([ParameterChange()], seen, corrected)] for corrected in (False, True)]
    assert "output" in stages[0]
    assert stages[1] == [s for s in stages[0] if s != "output"] != []


def test_the_answer_does_not_change_when_a_recording_is_cut():
    model = motor.model()
    whole = prepare(model, [motor.recording(60.0, 1, n=3000)])
    pieces = [whole[0].span(0, 1000), whole[0].span(1000, 2000), whole[0].span(2000, 3000)]
    names = []
    for runs in (whole, pieces):
        steps = search(settled(build(nominal(model, motor.DT), runs, Settings())), LIBRARY).steps
        names.append([s.candidates[0].hypothesis.physics for s in steps if s.accepted])
    assert names[0] == names[1] == ["coulomb_friction"]


def test_a_fit_is_a_stationary_point_of_its_posterior():
    p = problem(60.0)
    f = fit(p, p.start(), 0.0, 5.0)
    c = Coordinates(p, f.point)
    q = c.pack(f.point)

    def cost(q):
        e = np.vstack(weighted(p, c.unpack(q), 0.0))
        return len(e) / 5.0 * float(np.log(np.sqrt(np.mean(e**2, axis=0))).sum()) + c.penalty(q)

    for k in range(c.size):
        near = [cost(q + h * np.eye(c.size)[k]) for h in (-0.05, 0.05)]
        assert min(near) > cost(q) - 0.02


def test_losses_of_left_out_blocks_are_those_of_refits_without_them():
    p = problem(60.0)
    f = fit(p, p.start(), 0.0, 5.0)
    spans = block_spans([len(e) for e in f.residuals], f.tau, Settings())
    found = refitted(p, 0.0, f, spans, f.sd)
    for k in (3, 7, 16):  # not the first of a recording, whose initial state is not left out
        r, a, b = spans[k]
        runs = list(p.runs)
        hidden = runs[r].Y.copy()
        hidden[a:b] = np.nan
        runs[r] = replace(runs[r], Y=hidden)
        again = fit(replace(p, runs=tuple(runs)), f.point, 0.0, 5.0)
        left = (weighted(p, again.point, 0.0)[r][a:b] / f.sd) ** 2
        assert found[k] == pytest.approx(left.sum(0), rel=0.02)


def test_a_step_that_spoils_the_other_blocks_is_not_taken():
    p = problem(60.0)
    f = fit(p, p.start(), 0.0, 5.0)
    spans = block_spans([len(e) for e in f.residuals], f.tau, Settings())
    away = refitted(p, 0.0, replace(f, J=-f.J), spans, f.sd)
    assert away == pytest.approx(np.array([((f.residuals[r][a:b] / f.sd) ** 2).sum(0) for r, a, b in spans]))


def test_blocks_are_as_long_as_what_the_best_law_leaves_asks(found):
    """The friction that is missing makes the residual slow; fewer blocks would fit between its correlation times."""
    first, base = found.steps[0].candidates[0], found.start[0.0]
    lengths = [len(e) for e in base.residuals]
    blocks = {f.own_tau: len(block_spans(lengths, f.own_tau, Settings())) for f in (base, first.fit)}
    assert len(first.evidence.before) == blocks[first.fit.own_tau] > blocks[base.own_tau]


def test_the_evidence_knows_the_share_of_noise_where_the_excitation_repeats(found):
    """Of a residual of white noise, all that differs between periods is noise: its power but for that of the mean."""
    runs = tuple(replace(r, period=500) for r in found.problem.runs)
    for noisy, share in ((found.problem, 0.0), (replace(found.problem, runs=runs), 1.0)):
        rounds = forward.Rounds(noisy, noisy, noise_times([found.end]), found.start, found.start, "model", map, lambda problem, path: None, {}, lambda what, share: None)
        assert rounds.over(found.end, found.start, 1).noise == pytest.approx(share, abs=0.1)


@pytest.mark.parametrize(("samples", "factor"), [(1500, 2), (200, 7)])
def test_short_recordings_are_searched_more_widely(monkeypatch, samples, factor):
    asked = []

    def shortlist(problem, path, offered, mapper, count):
        asked.append(count)
        return [], {0.0: 0.0}

    monkeypatch.setattr(forward, "shortlist", shortlist)
    model = motor.model()
    runs = prepare(model, [motor.recording(60.0, 1, n=samples)])
    search(settled(build(nominal(model, motor.DT), runs, Settings())), LIBRARY)
    assert asked == [factor * Settings().refined]


def test_the_search_ends_though_offsets_take_turns(monkeypatch):
    monkeypatch.setattr(forward, "is_offset", lambda hypothesis: True)
    monkeypatch.setattr(forward.Rounds, "accepted", lambda self, first: (self.start, self.rough))  # each is idle beside the other
    short = problem(60.0, seeds=(1,))
    assert len(search(settled(replace(short, settings=replace(Settings(), effects=2))), LIBRARY).steps) == 4


def test_an_effect_that_was_dropped_and_found_again_is_named_once(found):
    step = found.steps[0]
    again = replace(step)
    assert [s.accepted for s in forward._kept([step, again], found.end)] == [False, True]
    assert [s.accepted for s in forward._kept([step], found.end)] == [True]
    assert [s.accepted for s in forward._kept([step], found.start)] == [False]


@pytest.mark.parametrize(("share", "accepted"), [(0.6, True), (0.1, False)])
def test_a_further_effect_counts_by_the_gap_where_noise_is_most_of_what_is_left(share, accepted):
    before = np.full((20, 1), 1.0)
    evidence = HypothesisEvidence({0.0: 100.0}, share, before, 0.95 * before, 5000.0, 0.0)
    assert evidence.closed < Settings().further
    rounds = SimpleNamespace(problem=SimpleNamespace(settings=Settings(), regular=True), limited="model")
    one = Candidate(Hypothesis("a", "machine", "", "force", None, (), (), (), ()), {}, evidence)
    assert forward._decided([one], "model", rounds, {0.0: 1.0}, further=True).accepted is accepted


@pytest.mark.parametrize(
    ("limited", "repeats", "r2", "penalty", "gap", "exhausted"),
    [
        ("model", (0.1, 0.0), (0.05, 0.1), 0.0, 1e6, True),
        ("noise", (0.1, 0.0), (0.05, 0.1), 0.0, 1e6, False),  # constants of the model and small gains count there
        ("model", None, (0.05, 0.1), 0.0, 1e6, False),  # what does not repeat bounds nothing
        ("model", (0.5, 0.0), (0.05, 0.1), 0.0, 1e6, False),
        ("model", (0.1, 0.0), (0.5, 0.1), 0.0, 1e6, False),
        ("model", (0.1, 0.0), (0.05, 0.1), 100.0, 1e6, False),  # numbers of the model could come back to what is stated
        ("model", (0.1, 0.0), (0.05, 0.1), 0.0, 500.0, False),  # small as it is, most of the first gap
    ],
)
def test_a_round_in_which_nothing_could_be_accepted_is_left_out(limited, repeats, r2, penalty, gap, exhausted):
    found = SimpleNamespace(repeats=repeats, within_reach=tuple(np.maximum(r2, repeats or 0.0)))
    last = SimpleNamespace(own_tau=2.0, penalty=penalty, narrowed=0.0, samples=1000, sd=np.array([1.0, 2.0]))
    rounds = SimpleNamespace(limited=limited, remainder=lambda problem, path: found, gap=lambda tau: gap, problem=SimpleNamespace(settings=Settings()))
    assert forward.Rounds.exhausted(rounds, {0.0: last}) is exhausted


