"""Parameters of Python code that laws change as a recording goes on, against scipy's integration."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from afdsvc.explain.simulate.nominal import nominal
from afdsvc.explain.simulate.simulator import Simulator

DT = 0.01
NUMBERS = {"gain": 2.0, "loss": 3.0, "read": 1.5}


class Store:
    @staticmethod
    def f(t, x, u, p):
        return [p["gain"] * u[0] - p["loss"] * x[0]]

    @staticmethod
    def h(t, x, u, p):
        return [p["read"] * x[0]]


class Sampled(Store):
    @staticmethod
    def f(t, x, u, p):
        return [x[0] + 0.01 * (p["gain"] * u[0] - p["loss"] * x[0])]


def aged(p, z, m, dt, out):
    out[0] -= p[0] * m[0] * z[0]
    m[0] += dt


def heavier(p, z, m, dt, out):
    out[0] += p[0] * z[1]


def doubled(p, z, m, dt, out):
    out[0] += z[0]


def played(model, recording, excitation, effects, code=Store, substeps=1):
    found = nominal(model(code=code, sizes=(1, 1, 1), parameters=NUMBERS, sample_time=DT if code is Sampled else 0.0), DT)
    run = recording(excitation)
    return [Simulator(found, np.zeros((1, 1)), substeps=substeps).run(run, np.zeros(3), np.zeros(1), effects).y[:, 0] for _ in range(2)]


@pytest.mark.parametrize(("number", "law", "reads"), [
    (0, aged, [("p", 0)]), (1, aged, [("p", 1)]), (2, aged, [("p", 2)]), (1, heavier, [("p", 1), ("x", 0)]), (2, heavier, [("p", 2), ("t", 0)]),
    (1, heavier, [("p", 1), ("p", 0)]),
])  # fmt: skip
def test_a_number_of_the_code_follows_its_law(model, recording, excitation, effect, number, law, reads):
    rate, signal = 0.15, reads[-1][0] + str(reads[-1][1])
    changing = effect(law, "parameter", reads, [("p", number)], [rate], memory=1)
    y, again = played(model, recording, excitation, [changing])
    state, expected = 0.0, []
    for k, u in enumerate(excitation[:, 0]):
        t, numbers = k * DT, list(NUMBERS.values())
        other = {"x0": state, "t0": t, "p0": numbers[0]}.get(signal, 0.0)
        numbers[number] += -rate * t * numbers[number] if law is aged else rate * other
        gain, loss, read = numbers
        expected.append(read * state)
        state = solve_ivp(lambda t, s, u=u, gain=gain, loss=loss: gain * u - loss * s, (0, DT), [state], rtol=1e-10, atol=1e-12).y[0, -1]
    (plain, _) = played(model, recording, excitation, [])
    assert np.linalg.norm(plain - expected) > 0.02 * np.linalg.norm(expected)
    assert np.linalg.norm(y - expected) < 1e-6 * np.linalg.norm(expected)
    assert np.array_equal(y, again)
    assert played(model, recording, excitation, [changing], substeps=3)[0] == pytest.approx(y, abs=1e-6 * np.abs(y).max())


def test_laws_of_one_number_come_one_after_the_other_in_sampled_code_too(model, recording, excitation, effect):
    twice = [effect(doubled, "parameter", [("p", 0)], [("p", 0)], []) for _ in range(2)]
    y, _ = played(model, recording, excitation, twice, Sampled)
    plain, _ = played(model, recording, excitation, [], Sampled)
    assert np.abs(plain).max() > 0.1
    assert y == pytest.approx(4 * plain, rel=1e-12)
