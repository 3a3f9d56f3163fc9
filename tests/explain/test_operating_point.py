"""A magnet recorded in absolute currents and gaps, with a model about its operating point."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.explain.pipeline import explain
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT, BIAS, GAP, WEIGHT = 0.002, 0.8, 0.006, 9.81  # s, A, m, m/s^2
PLANT = StateSpace(np.array([[0, 1.0], [2 * WEIGHT / GAP, 0]]), np.array([[0.0], [-2 * WEIGHT / BIAS]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
SD = {name: 0.1 * np.abs(matrix) * (np.abs(matrix) != 1) for name, matrix in (("A", PLANT.A), ("B", PLANT.B))}
MODEL = Model("magnet", (Variable("current", "A"),), (Variable("gap", "m"),), (Variable("gap", "m"), Variable("v", "m/s", rate_of="gap")), PLANT, entry_sd=SD)
LIBRARY = [p for p in afdsvc_physics() if p.name in ("magnetic_force", "gain_follows_position", "sensor_rectification", "back_emf", "cubic_stiffness")]


def recording(seed: int) -> Trace:
    """Return a body that hangs below a magnet under a controller nobody knows, following a reference that wanders."""
    rng, n = np.random.default_rng(seed), 3000
    reference, x, u, y = np.zeros(n), np.array([GAP, 0.0]), np.zeros(n), np.zeros(n)
    for k in range(1, n):
        reference[k] = 0.98 * reference[k - 1] + 0.0006 * np.sqrt(1 - 0.98**2) * rng.normal()
    for k in range(n):
        y[k] = x[0] + 1e-6 * rng.normal()
        u[k] = np.clip(BIAS + 540 * (y[k] - GAP - reference[k]) + 12 * x[1], 0, 3)
        for _ in range(10):
            x = x + DT / 10 * np.array([x[1], WEIGHT * (1 - (u[k] / BIAS) ** 2 * (GAP / x[0]) ** 2)])
    return Trace(f"r{seed}", DT, (Channel("u_current", "A"), Channel("y_gap", "m")), np.column_stack([u, y]))


def test_a_magnetic_force_is_found_in_absolute_signals():
    *given, held = map(recording, (40, 41, 42))
    found = explain(MODEL, given, [held], LIBRARY, experiment=False).named
    assert (found[0].physics, found[0].weight > 0.8) == ("magnetic_force", True)
    assert found[0].parameters["bias"].value == pytest.approx(BIAS, rel=0.05)
    assert found[0].parameters["gap"].value == pytest.approx(GAP, rel=0.05)
    assert "sensor_rectification" not in {n.physics for n in found}


def driven(law, begin: float, low: float, high: float, hold: int, dt: float, noise: float, seed: int, names: tuple[str, str]) -> Trace:
    """Return a machine of one state (Runge-Kutta, 20 steps per sample) under commands that are held for a while."""
    rng = np.random.default_rng(seed)
    u, x, y, h = np.repeat(rng.uniform(low, high, 30), hold), begin, [], dt / 20
    for now in u:
        y.append(x)
        for _ in range(20):
            k1 = law(x, now)
            k2 = law(x + h / 2 * k1, now)
            k3 = law(x + h / 2 * k2, now)
            x += h / 6 * (k1 + 2 * k2 + 2 * k3 + law(x + h * k3, now))
    return Trace(f"r{seed}", dt, (Channel(f"u_{names[0]}", "V"), Channel(f"y_{names[1]}", "rad/s")), np.column_stack([u, np.array(y) + noise * rng.standard_normal(len(u))]))


def tangent(name: str, slope: float, gain: float) -> Model:
    """Return the model of a speed about its operating point, 5 and 4 % beside the tangent of what is true."""
    plant = StateSpace(np.array([[1.05 * slope]]), np.array([[0.96 * gain]]), np.eye(1), np.zeros((1, 1)))
    speed = Variable("speed", "rad/s")
    return Model(name, (Variable("voltage", "V"),), (speed,), (speed,), plant, entry_sd={"A": 0.1 * np.abs(plant.A), "B": 0.1 * np.abs(plant.B)})


CURVES = ("quadratic_damping", "static_nonlinearity", "constant_load", "sensor_offset", "dead_zone", "saturation", "supply_droop", "gain_follows_level")


def test_the_drag_of_a_fan_that_turns_one_way_is_found_though_the_model_has_its_tangent():
    drag, gain, middle = 1e-3, 100.0, 200.0  # 1/rad, rad/s^2/V, rad/s
    *given, held = (driven(lambda w, u: gain * u - drag * w * w, middle, 0.1, 1.0, 60, 0.02, 1.0, s, ("voltage", "speed")) for s in (1, 2, 3))
    found = explain(tangent("fan", -2 * drag * middle, gain), given, [held], [p for p in afdsvc_physics() if p.name in CURVES], experiment=False).named
    assert [(n.physics, n.site) for n in found] == [("quadratic_damping", "state:speed")]
    assert found[0].weight > 0.8
    assert found[0].parameters["drag"].value == pytest.approx(drag / gain, rel=0.1)


def test_the_curve_of_a_valve_is_found_though_the_model_has_its_tangent_and_another_zero():
    """An exponential characteristic of the input, and a load that the model does not have."""
    *given, held = (driven(lambda w, u: np.exp(u - 2.0) - 0.8 * (w - 3.0), 4.0, 1.0, 3.0, 60, 0.1, 0.004, s, ("voltage", "speed")) for s in (1, 2, 3))
    found = explain(tangent("valve", -0.8, 1.0), given, [held], [p for p in afdsvc_physics() if p.name in CURVES], experiment=False).named
    assert {(n.physics, n.site) for n in found} == {("static_nonlinearity", "input:voltage")}  # a cubic, and what an exponential has beyond it
    assert found[0].weight > 0.8


def filtered(seed: int) -> Trace:
    """Return a coil, a resistor and a ceramic capacitor at a bias: its capacitance falls with its voltage."""
    rng, dt, inside = np.random.default_rng(seed), 5e-5, 5
    u, x, seen, h = np.repeat(rng.uniform(6.0, 10.0, 80), 25), np.array([8.0, 0.0]), [], 1e-5

    def rate(x, u):
        return np.array([x[1] * (1 + (x[0] / 9.5) ** 2) / 1.4, 90.0e-3 * (u - x[0]) - 4.0e-3 * x[1]]) * 1e3  # V, mA, s

    for now in u:
        seen.append(x)
        for _ in range(inside):
            k1 = rate(x, now)
            k2 = rate(x + h / 2 * k1, now)
            k3 = rate(x + h / 2 * k2, now)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3, now))
    y = np.array(seen) + [0.01, 0.05] * rng.standard_normal((len(u), 2))
    return Trace(f"r{seed}", dt, (Channel("u_source", "V"), Channel("y_voltage", "V"), Channel("y_current", "mA")), np.column_stack([u, y]))


def test_a_capacitance_that_follows_its_voltage_is_found_at_a_bias():
    A = np.array([[0, 1e3 * (1 + (8 / 9.5) ** 2) / 1.4 * 1.06], [-90.0, -4.2]])
    plant = StateSpace(A, np.array([[0.0], [90.0]]), np.eye(2), np.zeros((2, 1)))
    variables = (Variable("voltage", "V"), Variable("current", "mA"))
    model = Model("filter", (Variable("source", "V"),), variables, variables, plant, entry_sd={"A": 0.1 * np.abs(A), "B": 0.1 * np.abs(plant.B)})
    names = ("parameter_follows_state", "sensor_nonlinearity", "static_nonlinearity", "gain_follows_level", "self_heating")
    named = explain(model, [filtered(1), filtered(2)], [filtered(3)], [p for p in afdsvc_physics() if p.name in names], experiment=False).named
    assert [(n.physics, n.site) for n in named] == [("parameter_follows_state", "state:voltage")]
    assert named[0].weight > 0.7
