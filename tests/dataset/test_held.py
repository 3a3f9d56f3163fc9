"""Held readings: found by when they change, and taken at the samples that they say."""

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.dataset.held import interval, taken
from afdsvc.dataset.sample_checks import samples
from afdsvc.lti.statespace import StateSpace

RNG = np.random.default_rng(11)
MOVES = np.cumsum(RNG.normal(size=2400))


def held(x: np.ndarray, every: int, phase: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a signal read at ``phase, phase + every, ...`` and at the first sample, and when each reading was taken: sample by sample."""
    shown, when, last = [], [], 0
    for k in range(len(x)):
        if k % every == phase:
            last = k
        shown.append(x[last])
        when.append(last)
    return np.array(shown), np.array(when)


@pytest.mark.parametrize(("every", "phase"), [(2, 0), (2, 1), (5, 3), (8, 0), (100, 37)])
def test_the_interval_and_the_moments_of_readings_are_found(every, phase):
    y, when = held(MOVES, every, phase)
    assert interval(y) == every
    assert np.array_equal(taken(y, every), when)


def test_readings_that_stay_the_same_were_taken_too():
    moves = MOVES.copy()
    moves[800:1600] = moves[800]
    y, when = held(moves, 5, 3)
    assert interval(y) == 5
    assert np.array_equal(taken(y, 5), when)


def test_a_clock_that_slips_once_is_followed():
    y = np.concatenate([held(MOVES[:1203], 5, 3)[0], held(MOVES[1203:], 5, 3)[0]])
    assert interval(y) == 5
    assert np.array_equal(taken(y, 5)[1210:], 1203 + held(MOVES[1203:], 5, 3)[1][7:])


@pytest.mark.parametrize(("y", "why"), [
    (MOVES, "a reading at every sample"),
    (np.round(MOVES / 3) * 3, "coarse steps, passed at any time"),
    (np.repeat(RNG.normal(size=19), 60), "too few changes"),
    (np.repeat(np.arange(240) % 2, 10).astype(float), "a switch"),
    (np.where(np.arange(2400) == 1001, np.nan, held(MOVES, 8, 0)[0]), "gaps"),
])  # fmt: skip
def test_other_signals_are_read_at_every_sample(y, why):
    assert interval(y) == 1
    assert np.array_equal(taken(y, 1), np.arange(len(y)))


def machine() -> tuple[Model, Trace]:
    """Two outputs of one state, the second read at one sample of 8."""
    plant = StateSpace(np.array([[0.9]]), np.array([[0.1]]), np.ones((2, 1)), np.zeros((2, 1)), 0.1)
    model = Model("two readings", (Variable("u"),), (Variable("a"), Variable("b")), (Variable("x"),), plant)
    values = np.column_stack([RNG.normal(size=2400), MOVES, held(MOVES, 8, 3)[0]])
    return model, Trace("r", 0.1, (Channel("u_u"), Channel("y_a"), Channel("y_b")), values)


def test_a_run_shows_outputs_as_its_sensors_do_and_so_does_a_part_of_it():
    model, trace = machine()
    (run,) = prepare(model, [trace])
    both = np.column_stack([MOVES, MOVES])
    for part, here in ((run, slice(0, None)), (run.span(403, 1200), slice(403, 1200))):
        assert np.array_equal(part.shown(both[here]), part.Y)
        assert np.array_equal(part.fresh[:, 0], MOVES[here])
        assert np.array_equal(np.isfinite(part.fresh[:, 1]), (np.arange(2400)[here] % 8 == 3) | (np.arange(len(part)) == 0))
    assert np.array_equal(run.span(405, 450).shown(both[405:450])[:6, 1], np.full(6, MOVES[405]))  # read before the part begins


def test_the_check_says_how_often_a_sensor_is_read():
    model, trace = machine()
    (finding,) = [f for f in samples(model, prepare(model, [trace])) if f.topic == "held readings"]
    assert finding.sentence == "r: y_b changes at one of 8 samples only: it is read every 0.8 s and held in between; the model's output is held alike"
