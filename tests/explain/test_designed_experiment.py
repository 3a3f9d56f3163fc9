"""Excitation that repeats, so that noise is known: what is named, on a lag simulated by code of its own."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.explain.pipeline import explain
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT, PERIOD, PERIODS, POLE = 0.01, 600, 5, 8.0
PLANT = StateSpace(np.array([[-POLE]]), np.array([[POLE]]), np.eye(1), np.zeros((1, 1)))
MODEL = Model("oven", (Variable("power", "W"),), (Variable("temperature", "K"),), (Variable("x", "K"),), PLANT)


FINE = 20  # steps of the simulation in a sample

LIBRARY = [p for p in afdsvc_physics() if p.name in (
    "periodic_disturbance", "flexible_mode", "quantisation", "sensor_saturation", "transport_delay", "actuator_lag", "sensor_lag", "creep", "dead_zone", "parameter_change",
)]


def lag(u: np.ndarray, pole: float) -> np.ndarray:
    a = np.exp(-pole * DT / FINE)
    return lfilter([0.0, 1 - a], [1.0, -a], u)


def recording(seed: int, reading=lambda y, t, rng: y, late: float = 0.0) -> Trace:
    """Return a multisine of 30 odd lines through the lag, a second lag ``late`` (1/s, 0: none), white noise and the reading."""
    rng = np.random.default_rng(seed)
    t = DT * np.arange(PERIOD * (PERIODS + 1))
    lines = np.arange(1, 61, 2)
    u = np.sin(2 * np.pi * np.outer(t, lines) / (PERIOD * DT) + rng.uniform(0, 2 * np.pi, 30)).sum(1) / 4
    held = np.repeat(u, FINE)
    y = lag(lag(held, late) if late else held, POLE)[::FINE] + 0.02 * rng.standard_normal(len(t))
    kept = slice(PERIOD, None)
    return Trace(f"r{seed}", DT, (Channel("u_power"), Channel("y_temperature")), np.column_stack([u, reading(y, t, rng)])[kept])


def names(**hidden):
    runs = [recording(k, **hidden) for k in (1, 2, 3)]
    return explain(MODEL, runs[:2], runs[2:], LIBRARY, experiment=False).named


def outside_tone(y: np.ndarray, t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return y + 0.03 * np.cos(71.3 * t + rng.uniform(0, 2 * np.pi))


def steps(y: np.ndarray, t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return 0.1 * np.floor((y - 0.037) / 0.1 + 0.5) + 0.037


def test_a_tone_has_its_own_phase_in_every_recording():
    first = names(reading=outside_tone)[0]
    assert (first.physics, first.weight > 0.3) == ("periodic_disturbance", True)
    assert first.parameters["frequency"].value == pytest.approx(71.3, abs=0.02)
    assert first.parameters["amplitude"].value == pytest.approx(0.03, rel=0.1) or first.site != "output:temperature"


def test_coarse_readings_are_named_from_what_rounding_leaves_on_average():
    first = names(reading=steps)[0]
    assert (first.physics, first.site) == ("quantisation", "output:temperature")


def test_a_short_lag_and_a_delay_cannot_be_distinguished():
    """The start of a lag is unknown and counts for what the recordings say of it: no more than that of a delay, which has none."""
    found = {n.physics: n.weight for n in names(late=400.0)}
    assert found["transport_delay"] + found["actuator_lag"] + found.get("sensor_lag", 0.0) > 0.5
    assert min(found["transport_delay"], found["actuator_lag"]) > 0.1


def test_nothing_is_named_where_nothing_is_missing():
    assert not names()
