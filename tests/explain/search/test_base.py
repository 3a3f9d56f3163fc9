"""How inputs run between samples, where a recording leaves both open; which part of long recordings hypotheses are chosen on."""

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.search.base import settled
from afdsvc.explain.search.build import build
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.lti.statespace import StateSpace

DT, FINE = 0.01, 50


def lag() -> Model:
    plant = StateSpace(np.array([[-10.0]]), np.array([[10.0]]), np.array([[1.0]]), np.zeros((1, 1)))
    return Model("lag", (Variable("u"),), (Variable("y"),), (Variable("x"),), plant)


def recording(fine: np.ndarray) -> Trace:
    """Return what the lag does under an input sampled ``FINE`` times in a sample, by exact steps."""
    a = np.exp(-10.0 * DT / FINE)
    x, y = 0.0, np.empty(len(fine))
    for k, u in enumerate(fine):
        y[k] = x
        x = a * x + (1 - a) * u
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(fine) // FINE)
    return Trace("r", DT, (Channel("u_u"), Channel("y_y")), np.column_stack([fine[::FINE], y[::FINE] + noise]))


def ramped(trace: Trace) -> bool:
    runs = prepare(lag(), [trace])
    return settled(build(nominal(lag(), DT), runs, Settings())).problem.ramped


def test_an_input_of_an_analogue_source_is_smooth_and_one_of_a_converter_is_held():
    t = np.arange(800 * FINE) * DT / FINE
    smooth = np.sin(9.0 * t) + 0.7 * np.sin(31.0 * t + 1.0)
    assert ramped(recording(smooth))
    assert not ramped(recording(np.repeat(smooth[::FINE], FINE)))


@pytest.mark.parametrize("delay", [0, FINE // 2])
def test_a_staircase_is_held_even_where_a_shift_of_the_clock_makes_smoothness_fit_better(delay):
    levels = np.random.default_rng(1).uniform(-1, 1, 40)
    held = np.repeat(levels, 20 * FINE)
    early = replace(recording(np.roll(held, -delay)), values=recording(np.roll(held, -delay)).values.copy())
    early.values[:, 0] = held[::FINE]  # the machine moves before its input is read
    assert not ramped(early)


@pytest.mark.parametrize(("level", "error", "expected", "rest"), [
    (np.ones(1500), np.zeros(1500), 0.0, 0.0),
    (np.repeat([0.01, 1.0], [900, 600]), np.zeros(1500), 9.0, 0.0),  # it hardly moves at first
    (np.repeat([0.01, 1.0], [900, 600]), np.zeros(1500), 7.0, np.repeat([5.0, 0.0], [900, 600])),  # it rests far from its mean, until it is moved
    (np.ones(1500), np.repeat([0.0, 1.0], [1100, 400]), 11.0, 0.0),  # what is missed comes late
])  # fmt: skip
def test_hypotheses_are_chosen_where_the_machine_moves_and_is_missed(level, error, expected, rest):
    """400 of 1500 samples: the beginning, or the stretch that holds most; ``expected`` is its first moment [s]."""
    rng = np.random.default_rng(2)
    trace = recording(np.repeat(rng.standard_normal(1500) * level + rest, FINE))
    trace.values[:, 1] += error * 0.3 * np.sin(1.7 * np.arange(1500) * DT)
    found = settled(build(nominal(lag(), DT), prepare(lag(), [trace]), replace(Settings(), screened=400)))
    (part,), (whole,) = found.part.runs, found.problem.runs
    assert (len(part), len(whole)) == (400, 1500)
    assert part.t0 == pytest.approx(expected, abs=1.5 if expected else 0.0)
    first = round(part.t0 / DT)
    assert np.array_equal(part.Y, whole.Y[first : first + 400])
    assert found.part.x0[0] == pytest.approx(whole.Y[first], abs=0.3)
