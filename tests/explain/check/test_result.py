"""The check before any fit: each thing that is wrong with a recording is named, with its cure, and nothing else stops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.model import Model, Quantity, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.explain.check.result import check_all
from afdsvc.files.model.model_file import parse_model
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.plugins.manager import load

LIBRARY = [offer.thing for offer in load().family("physics")]
TEXT = """
name = "motor"
time = "continuous"
inputs = [{name = "voltage", unit = "V"}]
outputs = [{name = "speed", unit = "rad/s"}]
num = [12.0]
den = [0.08, 1]
"""
DT = 5e-3


def _recorded(model, *, gain=1.0, shift=0, dt=DT, seed=1, unrelated=False):
    """Random steps through the model's own plant, with a gain, a delay in samples, or readings of another day."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-5, 5, 400), 20)[:, None]
    driven = np.repeat(rng.uniform(-5, 5, 400), 20)[:, None] if unrelated else np.roll(u, shift, axis=0)
    y = gain * (simulate(sample_zoh(model.plant, DT), driven)[0] + 0.2 * rng.standard_normal((len(u), 1)))
    return Trace("run.csv", dt, (Channel("u_voltage"), Channel("y_speed")), np.hstack([u, y]))


@pytest.fixture(scope="module")
def model():
    return parse_model(TEXT, "motor.toml")


def test_a_model_that_fits_is_ready(model):
    found = check_all(model, [_recorded(model)], LIBRARY)
    assert found.verdict in ("ready", "limited")
    (output,) = found.outputs
    assert output.r2 > 0.99
    assert output.gain == pytest.approx(1.0, abs=0.01)
    assert output.delay == 0.0
    assert found.offers.axes == ("velocity speed [rad/s], its position is not in the model, driven by voltage",)
    assert found.offers.tried["coulomb_friction"] == ("state:speed",)
    assert "aux_speed" in found.offers.absent["unbalance"]
    assert "decays by itself and is no velocity" in found.offers.absent["slow_mode"]
    assert "a second axis" in found.offers.absent["gyroscopic_coupling"]
    assert found.offers.absent["clearance"] == "a state that is a position, and its velocity (rate_of)"
    assert "the model has this effect already" in found.offers.absent["viscous_damping"]
    assert found.offers.absent["periodic_disturbance"].endswith("explain tries it where one shows after the fit")
    assert any(f.sentence.startswith("the recordings fix 2 of 2 uncertain numbers of the model: their") for f in found.findings)
    assert found.plan.method == "auto"
    assert set(found.parameters) == {"A[1,1]", "B[1,1]"}
    assert max(found.parameters.values()) < 0.1


def test_gain_and_delay_are_measured(model):
    (output,) = check_all(model, [_recorded(model, gain=0.7, shift=4)], LIBRARY).outputs
    assert output.gain == pytest.approx(0.65, abs=0.06)
    assert output.delay == pytest.approx(4 * DT)


@pytest.mark.parametrize(("change", "delay"), [({"shift": 120}, 120 * DT), ({"unrelated": True}, 0.0)])
def test_long_delays_are_measured_and_those_of_unrelated_signals_are_not(model, change, delay):
    (output,) = check_all(model, [_recorded(model, **change)], LIBRARY).outputs
    assert output.delay == pytest.approx(delay, abs=DT)


@pytest.mark.parametrize(
    ("change", "topic", "words"),
    [
        ({"gain": 1 / 1000}, "units", ["times what the model says, about 1/1000", "expected the model's unit"]),
        ({"gain": -1.0}, "units", ["y_speed is of the opposite sign"]),
        ({"unrelated": True}, "response", ["y_speed does not respond to u_voltage", "recorded together"]),
    ],
)
def test_what_does_not_fit_is_refused_by_name(model, change, topic, words):
    found = check_all(model, [_recorded(model, **change)], LIBRARY)
    assert found.verdict == "refused"
    stops = " ".join(f.sentence for f in found.findings if f.kind == "stop" and f.topic == topic)
    assert all(word in stops for word in words), found.findings


def test_milliseconds_taken_for_seconds_are_suspected(model):
    found = check_all(model, [_recorded(model, dt=1000 * DT)], LIBRARY)
    (said,) = (f.sentence for f in found.findings if f.topic == "clock")
    assert "sampled every 5 s and the model's fastest time constant is 0.08 s" in said
    assert "t_ms" in said


def test_a_recording_shorter_than_the_model_is_slow(model):
    found = check_all(model, [_recorded(model, dt=DT / 1e5)], LIBRARY)
    assert any(f.topic == "clock" and "record for 0.24 s or more" in f.sentence for f in found.findings)


def test_a_missing_column_is_a_finding_and_not_an_error(model):
    trace = _recorded(model)
    other = replace(trace, channels=(Channel("u_voltage"), Channel("y_current")))
    found = check_all(model, [other], LIBRARY)
    assert found.verdict == "refused"
    assert "--map y_current=y_speed" in found.findings[0].sentence
    assert found.plan.method == ""
    assert found.outputs == ()


def test_a_state_that_is_no_velocity_has_no_friction(model):
    other = parse_model(TEXT.replace('unit = "rad/s"', 'unit = "A"'), "motor.toml")
    found = check_all(other, [_recorded(model)], LIBRARY)
    assert found.offers.axes == ()
    assert "velocity" in found.offers.absent["coulomb_friction"]


@pytest.mark.parametrize("rate", [lambda x, p: 1 / 0, lambda x, p: x**3 + p["a"], lambda x, p: np.exp(40 * x) - x, lambda x, p: -1e7 * x])
def test_code_that_leaves_all_numbers_is_checked_without_an_exception_or_a_warning(rate):
    class Code:
        f = staticmethod(lambda t, x, u, p: [rate(x[0], p) + u[0]])
        h = staticmethod(lambda t, x, u, p: [x[0]])

    words = (Variable("voltage", "V"),), (Variable("speed", "rad/s"),), (Variable("speed", "rad/s"),)
    model = Model("odd", *words, None, Code, 0.0, {"a": Quantity(1.0, "", 0.1)})
    data = np.random.default_rng(3).standard_normal((400, 2))
    data[:, 1] = 0.1 * np.cumsum(data[:, 1])
    found = check_all(model, [Trace("r", 0.1, (Channel("u_voltage", "V"), Channel("y_speed", "rad/s")), data)], LIBRARY)
    assert found.verdict in ("limited", "refused")
    assert all(f.sentence for f in found.findings)
