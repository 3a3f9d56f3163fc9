"""What repeats with every turn of a shaft of which only the speed is measured, or along a way: a torque of the motor, or an error of the sensor."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.explain.pipeline import explain
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT = 0.01
PLANT = StateSpace(np.array([[-8.0]]), np.array([[400.0]]), np.eye(1), np.zeros((1, 1)))
MODEL = Model("motor", (Variable("voltage", "V"),), (Variable("speed", "rpm"),), (Variable("speed", "rpm"),), PLANT)
LIBRARY = [p for p in afdsvc_physics() if p.name in ("cogging", "encoder_error", "coulomb_friction", "flexible_mode", "transport_delay", "sensor_nonlinearity", "quantisation")]


def recording(seed: int, torque: float, error: float, periods: int) -> Trace:
    """Return a motor under random levels, begun at a random angle: a torque ripple [rpm/s] and an error of the reading (a share of the speed)."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(1, 4, 10), 150)
    w, angle, y = 50.0, rng.uniform(0, 2 * np.pi), []
    for command in u:
        y.append(w * (1 + error * np.cos(periods * angle)))
        for _ in range(20):
            w += DT / 20 * (-8 * w + 400 * command + torque * np.cos(periods * angle))
            angle += DT / 20 * w * np.pi / 30
    return Trace(f"r{seed}", DT, (Channel("u_voltage", "V"), Channel("y_speed", "rpm")), np.column_stack([u, y + 0.3 * rng.standard_normal(len(u))]))


@pytest.mark.parametrize(("torque", "error", "periods", "name", "size"), [
    (100.0, 0.0, 12, "cogging", ("amplitude", 0.25)), (0.0, 0.02, 3, "encoder_error", ("share", 0.02)),
])
def test_a_ripple_is_named_with_its_periods_per_turn(torque, error, periods, name, size):
    *given, held = (recording(seed, torque, error, periods) for seed in (1, 2, 3))
    (found,) = explain(MODEL, given, [held], LIBRARY, experiment=False).named
    assert found.physics == name
    assert set(found.parameters) == {"periods per turn", size[0]}
    assert found.parameters["periods per turn"].value == pytest.approx(periods, abs=0.01)
    assert found.parameters[size[0]].value == pytest.approx(size[1], rel=0.05)


def test_an_error_of_a_screw_is_named_with_its_pitch_on_an_axis_that_drifts():
    """The motor goes where its steps send it, over 40 pitches, more than a search from the way travelled tries."""
    plant = StateSpace(np.array([[0.0, 1.0], [0.0, -30.0]]), np.array([[0.0], [70.0]]), np.eye(1, 2), np.zeros((1, 1)))
    model = Model("screw", (Variable("drive", "V"),), (Variable("length", "mm"),), (Variable("length", "mm"), Variable("speed", "mm/s", rate_of="length")), plant)

    def recording(seed: int) -> Trace:
        rng = np.random.default_rng(seed)
        goal, q, v, u, y = np.repeat(rng.uniform(-40, 40, 12), 200), 0.0, 0.0, [], []
        for r in goal:
            y.append(q + 0.1 * np.sin(np.pi * q + 0.4) + 0.002 * rng.standard_normal())
            u.append(np.clip(0.8 * (r - y[-1]), -12, 12))
            for _ in range(10):
                q, v = q + 5e-4 * v, v + 5e-4 * (-30 * v + 70 * u[-1] + 20 * rng.standard_normal())
        return Trace(f"r{seed}", 0.005, (Channel("u_drive", "V"), Channel("y_length", "mm")), np.column_stack([u, y]))

    some = [p for p in afdsvc_physics() if p.name in ("cogging", "encoder_error", "flexible_mode", "quantisation", "sensor_nonlinearity")]
    *given, held = (recording(seed) for seed in (1, 2, 3))
    first = explain(model, given, [held], some, experiment=False).named[0]
    assert (first.physics, first.site) == ("encoder_error", "output:length")
    assert first.parameters["wave number"].value == pytest.approx(np.pi, rel=3e-3)
    assert np.hypot(*(first.parameters[f"{part} part"].value for part in ("cosine", "sine"))) == pytest.approx(0.1, rel=0.05)
