"""Recordings as they come: with gaps, at another rate, in parts; handled or refused by name."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.dataset.split import split
from afdsvc.errors import BadInput
from afdsvc.explain.check.response import refuse_still
from afdsvc.explain.pipeline import explain
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.lti.sampling import continuous, sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT, PERIOD, PERIODS = 1e-3, 500, 4
PLANT = StateSpace(np.array([[0, 1.0], [-4e4, -30.0]]), np.array([[0.0], [4e4]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
STATES = (Variable("q", "mm"), Variable("v", "mm/s", rate_of="q"))


def model(plant: StateSpace = PLANT) -> Model:
    return Model("spring", (Variable("force", "N"),), (Variable("position", "mm"),), STATES, plant)


def recording(seed: int = 0, offset: float = 0.0) -> Trace:
    """A multisine through the plant itself, with a constant in the reading."""
    rng = np.random.default_rng(seed)
    lines = np.arange(1, 60, 2)
    t = np.arange(PERIOD) * DT
    u = np.tile(np.cos(2 * np.pi * np.outer(t, lines) / (PERIOD * DT) + rng.uniform(0, 7, len(lines))).sum(1), PERIODS)
    y = simulate(sample_zoh(PLANT, DT), u[:, None])[0][:, 0]
    values = np.column_stack([u, y + offset + 0.01 * rng.standard_normal(len(u))])
    return Trace(f"r{seed}", DT, (Channel("u_force"), Channel("y_position")), values)


def spoilt(trace: Trace, column: int, span: slice) -> Trace:
    values = trace.values.copy()
    values[span, column] = np.nan
    return replace(trace, values=values)


def test_gaps_in_a_reading_are_no_obstacle():
    traces = [spoilt(recording(k, 0.02), 1, slice(700, 760)) for k in range(3)]
    answer = explain(model(), traces, [recording(7, 0.02)], afdsvc_physics())
    assert "sensor_offset" in [n.physics for n in answer.named]


def test_a_gap_in_an_input_is_refused_with_its_place():
    with pytest.raises(BadInput, match=r"r0.*sample 700"):
        explain(model(), [spoilt(recording(0), 0, slice(700, 710))], [], afdsvc_physics())


def test_a_discrete_model_is_carried_over_to_another_rate():
    slow = sample_zoh(PLANT, 2 * DT)
    trace = recording(0)
    moved = nominal(model(slow), trace.dt)
    assert np.abs(moved.plant.A - PLANT.A).max() < 1e-6 * np.abs(PLANT.A).max()
    assert continuous(slow) is not None


def test_a_discrete_model_without_a_continuous_one_is_refused_at_another_rate():
    odd = StateSpace(np.array([[-0.5]]), np.array([[1.0]]), np.array([[1.0]]), np.zeros((1, 1)), 2 * DT)
    strange = replace(model(odd), states=(Variable("x"),))
    with pytest.raises(BadInput, match="and the recording every"):
        explain(strange, [recording(0)], [], afdsvc_physics())


def test_recordings_of_different_rates_are_refused_by_name():
    with pytest.raises(BadInput, match=r"'r0' \(0\.001 s\) and 'r1' \(0\.002 s\) differ in sample time; expected one: resample"):
        explain(model(), [recording(0), replace(recording(1), dt=2 * DT)], [], afdsvc_physics())


def test_what_is_held_out_is_never_fitted():
    (run,) = prepare(model(), [recording(0)])
    one = split([run], [])
    assert sum(len(r) for r in (*one.train, *one.heldout)) == len(run)
    assert one.heldout[0].t0 >= one.train[0].t0 + (len(one.train[0]) - 1) * DT
    runs = prepare(model(), [recording(k) for k in range(5)])
    many = split(runs[:4], runs[4:])
    assert [len(x) for x in (many.train, many.heldout)] == [4, 1]


@pytest.mark.parametrize(("moving", "fitted", "held"), [
    ([True, True, False], ["r0", "r2"], "r1"), ([False, True, False], ["r0", "r2", "r1"], "r1, "), ([True, False, True], ["r0", "r1"], "r2"),
    ([False, False], ["r0", "r1"], "r1, "),
])
def test_a_recording_in_which_an_output_moves_is_held_out(moving, fitted, held):
    runs = [r if m else replace(r, Y=0 * r.Y + 3) for r, m in zip(prepare(model(), [recording(k) for k in range(len(moving))]), moving, strict=True)]
    roles = split(runs, [])
    assert [r.name for r in roles.train] == fitted
    (name,) = roles.heldout_names
    assert name.startswith(held)
    assert sum(len(r) for r in (*roles.train, *roles.heldout)) == sum(map(len, runs))


def pair(dead: bool = False) -> tuple[Model, list[Trace]]:
    """Two machines of one kind side by side, the second at rest: nothing is played on it, and its sensor sees noise."""
    plant = StateSpace(*(np.kron(np.eye(2), M) for M in (PLANT.A, PLANT.B, PLANT.C, PLANT.D)))
    one = model()
    both = Model(
        "pair", tuple(Variable(f"{v.name}{i}", v.unit) for i in "ab" for v in one.inputs), tuple(Variable(f"{v.name}{i}", v.unit) for i in "ab" for v in one.outputs),
        tuple(Variable(f"{v.name}{i}", v.unit, rate_of=f"{v.rate_of}{i}" if v.rate_of else "") for i in "ab" for v in one.states), plant,
    )
    return both, [beside_rest(recording(seed), seed, dead) for seed in range(3)]


def beside_rest(trace: Trace, seed: int, dead: bool) -> Trace:
    names, columns = [], []
    for c, x in zip(trace.channels, trace.values.T, strict=True):
        still = 0 * x if c.name.startswith("u_") or dead else 1e-3 * np.std(x) * np.random.default_rng(seed).standard_normal(len(x))
        names += [Channel(f"{c.name}a"), Channel(f"{c.name}b")]
        columns += [x, still]
    return Trace(trace.name, trace.dt, tuple(names), np.column_stack(columns))


def test_an_input_on_which_nothing_is_played_is_reported_and_no_obstacle():
    both, (*given, held) = pair()
    answer = explain(both, given, [held], afdsvc_physics(), experiment=False)
    assert any("is not excited" in s for s in answer.check)


def test_a_sensor_that_never_moves_is_refused_by_name():
    both, (*given, held) = pair(dead=True)
    with pytest.raises(BadInput, match=r"y_\w+b reads 0 .* in every sample"):
        explain(both, given, [held], afdsvc_physics(), experiment=False)


@pytest.mark.parametrize(("which", "spoil", "said"), [
    (1, np.nan, "r1: y_position has no reading at all"),
    (2, np.nan, "r2: y_position has no reading at all"),  # held out
    (2, 0.0, "r2, held out: y_position reads 0 mm in every sample"),
])
def test_a_recording_without_readings_is_refused_by_name(which, spoil, said):
    traces = [recording(k) for k in range(3)]
    traces[which] = replace(traces[which], values=np.column_stack([traces[which].values[:, 0], np.full(len(traces[which]), spoil)]))
    with pytest.raises(BadInput, match=said):
        explain(model(), traces[:2], traces[2:], afdsvc_physics(), experiment=False)


def test_a_fitted_part_in_which_a_reading_never_moves_is_refused():
    (run,) = prepare(model(), [recording(0)])
    roles = split([run], [])
    with pytest.raises(BadInput, match="r0, fitted: y_position reads 2 mm in every sample"):
        refuse_still(model(), replace(roles, train=tuple(replace(r, Y=0 * r.Y + 2) for r in roles.train)))


def test_an_infinite_reading_is_refused_with_its_place():
    trace = recording(0)
    trace.values[123, 1] = np.inf
    with pytest.raises(BadInput, match="r0: y_position is infinite at sample 123"):
        explain(model(), [trace, recording(1)], [recording(2)], afdsvc_physics(), experiment=False)


def test_gaps_in_another_signal_are_bridged_and_reported():
    traces = [with_speed(recording(k), gap=slice(100, 140) if k == 0 else slice(0)) for k in range(3)]
    run = prepare(model(), traces)[0]
    assert run.AUX[100:140, 0] == pytest.approx(np.arange(100, 140) / 10)
    answer = explain(model(), traces[:2], traces[2:], afdsvc_physics(), experiment=False)
    assert "r0: aux_speed lacks 40 of 2000 samples; they are interpolated linearly" in answer.check
    lost = with_speed(recording(0), gap=slice(0, 2000))
    with pytest.raises(BadInput, match="r0: aux_speed has no value at all"):
        prepare(model(), [lost])


def with_speed(trace: Trace, gap: slice) -> Trace:
    speed = np.arange(len(trace)) / 10
    speed[gap] = np.nan
    return replace(trace, channels=(*trace.channels, Channel("aux_speed", "rad/s")), values=np.column_stack([trace.values, speed]))


def test_recordings_without_any_noise_have_no_coloured_noise():
    """Two simulators compared with each other: what is left is rounding."""
    traces = [replace(t, values=np.column_stack([t.values[:, 0], simulate(sample_zoh(PLANT, DT), t.values[:, :1])[0][:, 0]])) for t in map(recording, range(3))]
    answer = explain(model(), traces[:2], traces[2:], afdsvc_physics(), experiment=False)
    assert (answer.verdict, answer.named) == ("consistent", ())


def coasting(seed: int, begins: float, friction: float) -> Trace:
    """A car that coasts and does not stop: ``v' = -0.03 v - friction``, in closed form, speed read to 0.1 km/h."""
    t = 0.1 * np.arange(300)
    v = (begins + friction / 0.03) * np.exp(-0.03 * t) - friction / 0.03
    assert v.min() > 0
    return Trace(f"coasting {seed}", 0.1, (Channel("y_speed", "km/h"),), (v + 0.1 * np.random.default_rng(seed).standard_normal(300))[:, None])


@pytest.mark.parametrize("friction", [0.6, 0.0])
def test_what_a_motion_without_reversal_cannot_separate_is_named_together(friction):
    speed = (Variable("speed", "km/h"),)
    model = Model("car", (), speed, speed, StateSpace(np.array([[-0.03]]), np.zeros((1, 0)), np.eye(1), np.zeros((1, 0))))
    held = [coasting(3, 36.0, friction)]
    answer = explain(model, [coasting(1, 40.0, friction), coasting(2, 32.0, friction)], held, afdsvc_physics(), experiment=False)
    named = {n.physics: n for n in answer.named}
    if not friction:
        assert (answer.verdict, named) == ("consistent", {})
        return
    assert set(named) == {"coulomb_friction", "constant_load", "sensor_offset"}
    assert max(n.weight for n in named.values()) < 0.5
    (refitted,) = [float(m[1]) for m in (re.search(r"and ([\d.]+) % with its numbers refitted", said) for said in answer.sentences) if m]
    assert refitted > 10  # about zero: with an offset it would leave as little as the names do
    assert named["coulomb_friction"].parameters["force"].value == pytest.approx(friction, rel=0.02)
    assert named["constant_load"].parameters["force"].value == pytest.approx(-friction, rel=0.02)
