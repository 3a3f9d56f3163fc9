"""The sub-steps that Python code takes in a sample."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete

from afdsvc.explain.simulate.nominal import nominal
from afdsvc.explain.simulate.simulator import Simulator


class Volts:
    """An axis whose position is in tiny and whose speed in large units: large slopes, slow poles."""

    @staticmethod
    def f(t, x, u, p):
        return [1e6 * x[1], -3e-5 * x[0] - 0.8 * x[1] + 2e-5 * u[0]]

    @staticmethod
    def h(t, x, u, p):
        return [x[0]]


def test_units_of_states_ask_for_no_substeps(model, recording, excitation):
    found, run = nominal(model(code=Volts), 0.01), recording(excitation)
    simulator = Simulator(found, np.zeros((2, 1)))
    simulated = simulator.run(run, np.zeros(0), np.zeros(2))
    assert simulator._needed(simulated, np.zeros(0), 1) == 1


class Coil:
    """A motor behind a coil whose time constant is far below a sample: speed, current."""

    @staticmethod
    def f(t, x, u, p):
        w, i = x
        return [50.0 * i - 2.0 * w, (u[0] - i) / p["tau"]]

    @staticmethod
    def h(t, x, u, p):
        return [x[0]]


@pytest.mark.parametrize(("tau", "steps"), [(0.1, 1), (2e-3, 16), (5.1e-4, 20), (1.02e-4, 99)])
def test_poles_faster_than_samples_show_take_the_steps_they_need_and_leave_the_slow_ones_right(model, recording, excitation, tau, steps):
    found, run = nominal(model(code=Coil, parameters={"tau": tau}), 0.01), recording(excitation)
    assert found.steps(np.zeros(1)).nsub == steps
    y = Simulator(found, np.zeros((2, 1))).run(run, np.zeros(1), np.zeros(2)).y[:, 0]
    A, B, *_ = cont2discrete((np.array([[-2.0, 50.0], [0.0, -1 / tau]]), np.array([[0.0], [1 / tau]]), np.eye(2), np.zeros((2, 1))), 0.01)
    states = [np.zeros(2)]
    for u in excitation[:-1]:
        states.append(A @ states[-1] + B @ u)
    expected = np.array(states)[:, 0]
    assert np.abs(y - expected).max() < 2e-3 * np.abs(expected).max()


class Stop:
    """A mass that meets a stop a thousand times stiffer than its spring."""

    @staticmethod
    def f(t, x, u, p):
        q, v = x
        hit = max(q - 0.5, 0.0)
        return [v, u[0] - p["spring"] * q - 2.0 * v - 1e8 * hit - (1e4 * v if hit > 0 else 0.0)]

    @staticmethod
    def h(t, x, u, p):
        return [x[0]]


def test_poles_that_code_has_on_its_way_alone_are_followed(model, recording):
    """At rest its poles turn by 0.1 rad in a sample, in the stop by 100."""
    force = np.repeat([[0.0], [100.0], [-50.0], [120.0]], 50, axis=0)
    found = nominal(model(code=Stop, parameters={"spring": 100.0}), 0.01)
    y = Simulator(found, np.zeros((2, 1))).run(recording(force), np.zeros(1), np.zeros(2)).y[:, 0]
    assert found.most == 16
    assert np.isfinite(y).all()
    assert y.max() == pytest.approx(0.5, abs=1e-3)


def test_a_fit_that_makes_a_pole_faster_than_samples_show_takes_no_more_steps_for_it(model):
    found = nominal(model(code=Coil, parameters={"tau": 0.1}), 0.01)
    assert found.steps(np.array([-9.999])).nsub == found.most == 16  # tau of 10 microseconds
    stiff = nominal(model(code=Coil, parameters={"tau": 5.1e-4}), 0.01)
    assert stiff.most == 157
