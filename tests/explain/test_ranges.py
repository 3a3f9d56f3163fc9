"""Laws whose numbers lie far from what the excitation suggests."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.explain.pipeline import explain
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT, PERIOD, PERIODS, NOISE, PARTS = 1e-3, 1000, 4, 0.02, 50
LIBRARY = [p for p in afdsvc_physics() if p.name in ("slew_limit", "actuator_lag", "saturation", "dead_zone", "creep", "transport_delay")]


def spring() -> Model:
    plant = StateSpace(np.array([[0, 1.0], [-4e4, -30.0]]), np.array([[0.0], [4e4]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
    states = (Variable("q", "mm"), Variable("v", "mm/s", rate_of="q"))
    return Model("spring", (Variable("force", "N"),), (Variable("position", "mm"),), states, plant, output_sd=np.array([NOISE]))


def slewed(seed: int, level: float, rate: float) -> Trace:
    """A multisine through a drive that rises by ``rate`` a second, in `PARTS` parts of a sample."""
    rng = np.random.default_rng(seed)
    t, lines = np.arange(PERIOD) * DT, np.arange(1, 120, 2)
    waves = np.cos(2 * np.pi * np.outer(t, lines) / (PERIOD * DT) + rng.uniform(0, 2 * np.pi, len(lines))).sum(1)
    u = level * np.tile(waves / waves.std(), PERIODS)
    way = np.diff(u, prepend=u[0])[:, None]  # every step is over within its sample
    since = (np.arange(PARTS) + 0.5) * DT / PARTS
    force = (u[:, None] - way + np.clip(way, -rate * since, rate * since)).ravel()
    y = simulate(sample_zoh(spring().plant, DT / PARTS), force[:, None])[0][::PARTS, 0]
    return Trace(f"r{seed}", DT, (Channel("u_force"), Channel("y_position")), np.column_stack([u, y + NOISE * rng.standard_normal(len(u))]))


def test_a_drive_that_is_slow_within_the_step_alone_is_a_slew_limit():
    """No step of the command reaches its limit, but most of them take a part of the step."""
    rate = 8.0 / DT
    *given, held = [slewed(seed, level, rate) for seed, level in enumerate((1.0, 0.6, 0.8))]
    assert max(np.abs(np.diff(r.values[:, 0])).max() for r in given) / DT < rate
    answer = explain(spring(), given, [held], LIBRARY, experiment=False)
    assert (answer.named[0].physics, answer.named[0].site) == ("slew_limit", "input:force")
    assert answer.named[0].parameters["rate"].value == pytest.approx(rate, rel=0.15)


def valve(seed: int) -> Trace:
    """A valve that is closed from 4.25 to 5.9 V, behind it 3 bar/s per volt and a leak of 1.5 1/s; pressure about 2 bar, pushed at random."""
    rng, n, dt = np.random.default_rng(seed), 2000, 0.02
    u = np.repeat(rng.uniform(3.0, 7.0, n // 20), 20)
    opened = np.where(u > 5.9, u - 5.9, np.minimum(u - 4.25, 0.0))
    held, pushed = np.exp(-1.5 * dt), lfilter([0.001], [1, -0.9], rng.standard_normal(n))
    y = 2.0 + lfilter([0, 1], [1, -held], 3.0 * (1 - held) / 1.5 * opened + pushed)
    return Trace(f"r{seed}", dt, (Channel("u_valve"), Channel("y_pressure")), np.column_stack([u, y + 0.01 * rng.standard_normal(n)]))


def test_a_valve_that_is_closed_about_half_its_voltage_has_a_dead_zone_there():
    plant = StateSpace.of([[-1.7]], [[2.7]], [[1.0]])
    model = Model("valve", (Variable("valve", "V"),), (Variable("pressure", "bar"),), (Variable("pressure", "bar"),), plant, entry_sd={"A": np.array([[0.3]]), "B": np.array([[0.4]]), "C": np.zeros((1, 1))})
    library = [p for p in afdsvc_physics() if p.name in ("dead_zone", "saturation", "static_nonlinearity", "hysteresis", "backlash", "constant_load", "sensor_offset")]
    *given, held = [valve(seed) for seed in range(3)]
    answer = explain(model, given, [held], library, experiment=False)
    first = answer.named[0]
    assert (first.physics, first.site) == ("dead_zone", "input:valve")
    assert {k: v.value for k, v in first.parameters.items()} == pytest.approx({"width": 0.825, "centre": 5.075}, abs=0.05)
    assert answer.fit[0].after_nrmse < 0.1
