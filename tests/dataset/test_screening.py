"""Recordings that cannot be fitted: each fault is named, and healthy recordings pass."""

import numpy as np
import pytest

from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.screening import require_sizes, screen
from afdsvc.errors import BadInput
from afdsvc.lti.simulate import simulate

CHANNELS = (Channel("u_first", "V"), Channel("u_second", "V"), Channel("y_first", "um"), Channel("y_second", "um"))


@pytest.fixture
def healthy(oscillators):
    rng = np.random.default_rng(1)
    u = rng.standard_normal((5000, 2))
    y = simulate(oscillators(1), u)[0] + 0.1 * rng.standard_normal((5000, 2))
    return Trace("run.mcap", 1e-3, CHANNELS, np.hstack([u, y]))


def _changed(trace, column, values):
    table = trace.values.copy()
    table[:, column] = values
    return Trace(trace.name, trace.dt, trace.channels, table)


def test_healthy_recordings_pass(healthy):
    screen(healthy, 1000)
    binary = np.sign(np.random.default_rng(2).standard_normal(5000))
    screen(_changed(healthy, 0, binary), 1000)  # a switched input lives at its ends
    screen(_changed(healthy, 2, np.round(healthy.values[:, 2], 1)), 1000)  # a coarse sensor is not a gap


def test_too_short(healthy):
    with pytest.raises(BadInput, match=r"run.mcap: 300 samples \(0.3 s\) are too short; expected at least 1000 \(1 s\)"):
        screen(healthy.span(0, 300), 1000)


def test_missing_samples(healthy):
    y = healthy.values[:, 3].copy()
    y[[1700, 1701]] = np.nan
    with pytest.raises(BadInput, match=r"run\.mcap: 2 samples of 'y_second' are missing, the first at 1.7 s"):
        screen(_changed(healthy, 3, y), 1000)


def test_frozen_recorder(healthy):
    table = healthy.values.copy()
    table[2000:2030] = table[2000]
    with pytest.raises(BadInput, match=r"every signal stands still for 29 samples from 2 s on"):
        screen(Trace("run.mcap", 1e-3, CHANNELS, table), 1000)


def test_saturated_actuator(healthy):
    clipped = np.clip(healthy.values[:, 1], -10, 1.8)
    share = 100 * (healthy.values[:, 1] >= 1.8).mean()
    with pytest.raises(
        BadInput, match=rf"'u_second' sits at its highest value 1.8 V in {share:.3g} %.*the actuator saturates"
    ):
        screen(_changed(healthy, 1, clipped), 1000)


def test_drifting_sensor(healthy):
    y = healthy.values[:, 2]
    drift = np.linspace(-1, 1, 5000) * 2 * y.std()
    with pytest.raises(BadInput, match=r"'y_first' drifts by .* um over the recording"):
        screen(_changed(healthy, 2, y + drift), 1000)


def test_few_samples_have_no_trend(healthy):
    """A stretch before a missing sample may be as short as this; its drift is not judged, and numpy has nothing to warn of."""
    screen(healthy.span(0, 9), 9)


def test_false_refusals_are_rare(oscillators):
    """200 healthy recordings with slow noise (one time constant is a fiftieth of the record): fewer than 2 % refused."""
    from scipy import signal

    refused = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        slow = signal.lfilter([1], [1, -0.98], rng.standard_normal((2500, 4)), axis=0)
        try:
            screen(Trace("run", 1e-3, CHANNELS, slow), 100)
        except BadInput:
            refused += 1
    assert refused < 4


@pytest.mark.parametrize("size", [1e-250, 1e250])
def test_numbers_that_cannot_be_squared_are_refused(healthy, size):
    require_sizes(healthy)
    require_sizes(_changed(healthy, 2, 0.0))
    missing = healthy.values[:, 2].copy()
    missing[3] = np.nan
    require_sizes(_changed(healthy, 2, missing))
    with pytest.raises(BadInput, match=r"run.mcap: y_first has values of up to .*; expected sizes between 1e-60 and 1e\+60"):
        require_sizes(_changed(healthy, 2, size * healthy.values[:, 2]))
