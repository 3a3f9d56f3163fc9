"""Effects beside others: what each begins a recording with, and which mechanism stands where the others are known."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from afdsvc.api.signals import Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.search.base import settled
from afdsvc.explain.search.build import build
from afdsvc.explain.search.fit import Coordinates, borrowed, fit, jacobian, weighted
from afdsvc.explain.search.forward import Rounds, search
from afdsvc.explain.search.machine import hypotheses, machine
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.effects import PlacedEffect
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.explain.verdict.holdout import player
from afdsvc.plugins.physics.actuator_lag import ActuatorLag
from afdsvc.plugins.physics.coulomb_friction import CoulombFriction
from afdsvc.plugins.physics.dead_zone import DeadZone
from afdsvc.plugins.physics.sensor_lag import SensorLag
from afdsvc.plugins.physics.slew_limit import SlewLimit

_spec = importlib.util.spec_from_file_location("motor", Path(__file__).parents[1] / "motor.py")
motor = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(motor)
TAU = 0.3  # s, of the drive


def behind_a_slow_drive(seed, n=2400, parts=3):
    """The motor without friction behind a first-order drive, integrated in 20 steps a sample; cut in parts, with the drive's state at each cut."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-6, 6, n // 80), 80)
    w, v, h, rows, begun = 0.0, 0.0, motor.DT / 20, [], []
    for k in range(n):
        if k % (n // parts) == 37:  # not where the command has just changed
            begun.append(v)
        rows.append([u[k], w + 0.3 * rng.standard_normal()])
        for _ in range(20):
            v += h / TAU * (u[k] - v)
            w += h * (-2.0 * w + 50.0 * v)
    channels, table = motor.recording(0.0, 0, n=100).channels, np.array(rows)
    traces = [Trace(f"part {i}", motor.DT, channels, part[37:]) for i, part in enumerate(np.split(table, parts))]
    return traces, begun


def problem(traces):
    model = motor.model()
    runs = prepare(model, traces)
    return build(nominal(model, runs[0].dt), runs, Settings())


@pytest.fixture(scope="module")
def drive():
    traces, begun = behind_a_slow_drive(5)
    return search(settled(problem(traces)), [ActuatorLag(), SlewLimit(), CoulombFriction()]), traces, begun


def test_what_a_drive_begins_every_recording_with_is_found(drive):
    found, _, begun = drive
    (effect,) = found.end[0.0].point.effects
    assert effect.hypothesis.physics == "actuator_lag"
    assert effect.values[0] == pytest.approx(TAU, rel=0.03)
    assert np.concatenate(effect.begun) == pytest.approx(begun, abs=0.3)
    assert max(map(abs, begun)) > 1.0


def test_recordings_held_out_begin_with_their_own(drive):
    found, traces, _ = drive
    play = player(found.problem, list(found.end)[-1])
    (error,) = play.nrmse(prepare(motor.model(), traces[1:2]), found.end[0.0].point)
    assert error < 0.02


def test_a_borrowed_jacobian_is_the_jacobian_where_the_effect_was_added():
    p = problem(behind_a_slow_drive(6)[0])
    base = fit(p, p.start(), 0.0, 5.0)
    h = next(iter(hypotheses([ActuatorLag()], machine(p, base, 0.0))))
    point = base.point.added(PlacedEffect(h, np.array([1e-3 * TAU])))  # so fast that the numbers of the model act as before
    c = Coordinates(p, point)
    whole = jacobian(p, c, c.pack(point), 0.0, weighted(p, point, 0.0))
    assert borrowed(p, base, point, 0.0) == pytest.approx(whole, abs=2e-2 * np.abs(whole).max())
    assert np.abs(whole[:, -1]).max() > 0.0  # what the last recording begins with


def test_a_stand_in_gives_way_once_the_other_effects_are_known():
    lag = np.exp(-motor.DT / 0.15)
    traces = []
    for seed in (1, 2):
        rubbed = motor.recording(60.0, seed, noise=0.5)
        values = rubbed.values.copy()
        values[:, 1] = lfilter([1 - lag], [1, -lag], values[:, 1])
        traces.append(replace(rubbed, name=f"r{seed}", values=values))
    base = settled(problem(traces))
    rounds = Rounds(base.problem, base.part, base.taus, base.start, base.rough, base.limited, map, lambda problem, path: None, {}, lambda what, share: None)
    seen = machine(base.problem, list(base.start.values())[-1], 0.0)
    step = rounds.next(base.start, base.rough, hypotheses([CoulombFriction(), DeadZone()], seen), False)
    by_name = {c.hypothesis.physics: c for c in reversed(step.candidates)}
    path, rough = rounds.accepted(by_name["dead_zone"])
    further = rounds.next(path, rough, hypotheses([SensorLag()], seen), True)
    path, _ = rounds.accepted(further.candidates[0])
    stand_in = replace(step, candidates=(by_name["dead_zone"], by_name["coulomb_friction"]), accepted=True)
    path, steps = rounds.exchanged(path, [stand_in, replace(further, accepted=True)])
    assert [s.candidates[0].hypothesis.physics for s in steps] == ["coulomb_friction", "sensor_lag"]
    friction = next(e for e in path[0.0].point.effects if e.hypothesis.physics == "coulomb_friction")
    assert friction.values[0] == pytest.approx(60.0, rel=0.1)
    again = rounds.exchanged(path, steps[::-1])[1]  # what gains most comes first, in whatever order it was found
    assert [s.candidates[0].hypothesis.physics for s in again] == ["coulomb_friction", "sensor_lag"]
