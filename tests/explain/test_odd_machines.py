"""Machines as they come: unstable by themselves, under a controller nobody wrote down, with a drifting sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.explain.pipeline import explain
from afdsvc.files.model.model_file import parse_model
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics
from afdsvc.trial.folder import nominal_model_text
from afdsvc.trial.study import make_trial, plan

DT, PERIOD, PERIODS, NOISE = 1e-3, 500, 4, 0.003
STATES = (Variable("q", "mm"), Variable("v", "mm/s", rate_of="q"))
FORCE, POSITION = (Variable("force", "N"),), (Variable("position", "mm"),)
LIBRARY = [p for p in afdsvc_physics() if p.name in (
    "cubic_stiffness", "clearance", "coulomb_friction", "quadratic_damping", "hysteresis", "dead_zone", "static_nonlinearity", "actuator_lag",
    "sensor_rectification", "sensor_nonlinearity", "sensor_drift", "sensor_offset", "constant_load", "parameter_change",
)]  # fmt: skip
UNSTABLE, GAIN, DAMPING = 4e3, 4e4, 60.0  # q'' = UNSTABLE q - DAMPING v + GAIN u: it falls over in 16 ms
HOLD = -1.1  # u = HOLD y + alpha keeps it up


def falling(known: bool) -> Model:
    plant = StateSpace(np.array([[0, 1.0], [UNSTABLE, -DAMPING]]), np.array([[0.0], [GAIN]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
    return Model("falling", FORCE, POSITION, STATES, plant, controller=StateSpace.gain(np.array([[HOLD]]), DT) if known else None)


def balanced(seed: int, level: float, cubic: float = 0.0, drift: float = 0.0) -> Trace:
    """A multisine added to the command of the balanced machine, by classical Runge-Kutta in four steps a sample."""
    rng = np.random.default_rng(seed)
    lines = np.array([k for i, k in enumerate(range(1, 50, 2)) if i % 4 != 3])
    t = np.arange(PERIOD) * DT
    alpha = np.cos(2 * np.pi * np.outer(t, lines) / (PERIOD * DT) + rng.uniform(0, 2 * np.pi, len(lines))).sum(1)
    alpha = np.tile(level * alpha / alpha.std(), PERIODS + 1)
    x, rows, h = np.zeros(2), [], DT / 4

    def slope(x: np.ndarray, u: float) -> np.ndarray:
        return np.array([x[1], UNSTABLE * x[0] - DAMPING * x[1] + GAIN * u - cubic * x[0] ** 3])

    for k, a in enumerate(alpha):
        y = x[0] + NOISE * rng.standard_normal() + drift * k * DT
        u = HOLD * y + a
        rows.append((u, y, a))
        for _ in range(4):
            s = [slope(x, u)]
            for part in (0.5, 0.5, 1.0):
                s.append(slope(x + part * h * s[-1], u))
            x = x + h / 6 * (s[0] + 2 * s[1] + 2 * s[2] + s[3])
    names = (Channel("u_force"), Channel("y_position"), Channel("alpha_force"))
    return Trace(f"r{seed}", DT, names, np.array(rows)[PERIOD:])


def four(**hidden: float) -> list[Trace]:
    return [balanced(seed, level, **hidden) for seed, level in enumerate((0.3, 0.15, 0.25, 0.2))]


@pytest.mark.parametrize("known", [True, False])
def test_physics_is_named_on_a_machine_that_falls_over_by_itself(known):
    *recordings, held = four(cubic=2e4)
    if not known:
        recordings, held = [without(r, "alpha_force") for r in recordings], without(held, "alpha_force")
    answer = explain(falling(known), recordings, [held], LIBRARY, experiment=False)
    assert any("not stable by itself" in s for s in answer.check)
    assert any("the controller is known" in s for s in answer.check) == known
    assert any("or the controller is closed around it" in s for s in answer.check) == known
    assert (answer.named[0].physics, answer.named[0].site) == ("cubic_stiffness", "state:v")
    assert answer.simulated == ("in closed loop" if known else "predicted")
    assert answer.named[0].weight > 0.9 or not known  # in the loop nothing is left after it, so a clearance that fits 98 % is no look-alike
    assert answer.fit[0].after_nrmse < 1.3 * answer.fit[0].noise_floor_nrmse


@pytest.mark.parametrize("known", [True, False])
def test_nothing_is_named_where_nothing_is_hidden_on_an_unstable_machine(known):
    *recordings, held = four()
    answer = explain(falling(known), recordings, [held], LIBRARY, experiment=False)
    assert answer.verdict == "consistent"


def test_a_reading_that_drifts_is_named_or_stated():
    *recordings, held = four(drift=0.02)
    answer = explain(falling(True), recordings, [held], LIBRARY, experiment=False)
    assert "sensor_drift" in [n.physics for n in answer.named] or any("drift" in s for s in answer.check)


def test_a_drifting_plant_is_held_to_its_recordings():
    """A free mass in closed loop with a cubic spring left out: simulated from its inputs alone it goes elsewhere altogether."""
    cubic = (r for r in plan(300, 2029) if r.part == "axis" and r.wishes[0].physics == "cubic_stiffness" and r.wishes[0].rho == 0.3)
    trial = make_trial(next(cubic))
    model = parse_model(nominal_model_text(trial.machine), "model.toml")
    answer = explain(model, trial.recordings, (trial.holdout,), LIBRARY, experiment=False)
    assert answer.simulated in ("in closed loop", "predicted")
    assert (answer.named[0].physics, answer.named[0].site) == ("cubic_stiffness", "state:v")
    assert answer.fit[0].after_nrmse < 1.2 * answer.fit[0].noise_floor_nrmse


def without(trace: Trace, name: str) -> Trace:
    kept = [i for i, c in enumerate(trace.channels) if c.name != name]
    return replace(trace, channels=tuple(trace.channels[i] for i in kept), values=trace.values[:, kept])


def drives(off: float = 1.0) -> StateSpace:
    """A motor with a lag that drives a flywheel through a belt: three states, the speed is seen; ``off`` scales all but the structure."""
    lag, belt, damping = 3.0 * off, 20.0 / off, 0.3 * off
    A = np.array([[-lag, 0, 0], [0, 0, 1.0], [belt**2, -(belt**2), -2 * damping * belt]])
    return StateSpace(A, np.array([[lag], [0], [0]]), np.array([[0, 1.0, 0]]), np.zeros((1, 1)))


def counted(seed: int) -> Trace:
    """Return 10 s of steps of both signs at 50 Hz; the pulse counter sees how fast, and not which way."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1, 1], 50) * rng.uniform(0.3, 1.5, 50), 10)
    speed = simulate(sample_zoh(drives(), 0.02), u[:, None])[0][:, 0]
    return Trace(f"r{seed}", 0.02, (Channel("u_motor"), Channel("y_speed")), np.column_stack([u, np.abs(speed) + 0.01 * rng.standard_normal(500)]))


def test_a_pulse_counter_that_knows_no_direction_is_named():
    """The structure of the coupled electric drives of Wigren and Schoukens (2017), with constants of our own: a linear plant and ``|speed|``."""
    plant = drives(1.05)
    sd = {"A": 0.1 * np.abs(plant.A) * (np.abs(plant.A) != 1), "B": 0.1 * plant.B, "C": 0 * plant.C}
    states = (Variable("drive", "V"), Variable("w", "1/s"), Variable("a", "1/s^2", rate_of="w"))
    model = Model("drives", (Variable("motor", "V"),), (Variable("speed", "1/s"),), states, plant, entry_sd=sd)
    answer = explain(model, [counted(1), counted(2)], [counted(3)], LIBRARY, experiment=False)
    assert [(n.physics, n.site) for n in answer.named] == [("sensor_rectification", "output:speed")]
    assert answer.named[0].parameters["sign lost"].value == pytest.approx(1.0, abs=0.03)
    assert answer.fit[0].before_nrmse > 1
    assert answer.fit[0].after_nrmse < 0.1


def loaded(seed: int) -> Trace:
    """Return 10 s of a mass under forces that change every 0.1 s, and under a load of 0.3 N that is not recorded."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(100), 10)
    mass = StateSpace(np.array([[0, 1.0], [0, -2.0]]), np.array([[0], [5.0]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
    q = simulate(sample_zoh(mass, 0.01), u[:, None] + 0.3)[0][:, 0]
    return Trace(f"r{seed}", 0.01, (Channel("u_force"), Channel("y_position")), np.column_stack([u, q + 0.002 * rng.standard_normal(1000)]))


def test_a_constant_load_of_an_integrating_plant_is_reported():
    plant = StateSpace(np.array([[0, 1.0], [0, -2.0]]), np.array([[0], [5.0]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
    answer = explain(Model("mass", FORCE, POSITION, STATES, plant), [loaded(0), loaded(1)], [loaded(2)], LIBRARY, experiment=False)
    (said,) = [s for s in answer.sentences if s.startswith("a constant load")]
    assert float(said.split()[3]) == pytest.approx(0.3, rel=0.05)
    assert said.endswith("N on v is fitted to these recordings; the improved model does not have it")
    assert answer.named == ()
