"""Outputs that are accelerations: what an accelerometer reads of forces that the model leaves out, against scipy's integration."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

from afdsvc.api.model import Variable
from afdsvc.api.physics import Signal
from afdsvc.explain.simulate.nominal import felt, nominal
from afdsvc.explain.simulate.simulator import Simulator
from afdsvc.lti.statespace import StateSpace

DT = 0.01
SPRING, DAMPER, GAIN = 30.0, 0.8, 20.0
FORCED = StateSpace.of([[0, 1], [-SPRING, -DAMPER]], [[0], [GAIN]], [[1, 0], [-SPRING, -DAMPER]], [[0], [GAIN]])
ON_A_BASE = StateSpace.of([[0, 1], [-SPRING, -DAMPER]], [[0], [-1000]], [[1, 0], [-SPRING / 1000, -DAMPER / 1000]])  # mm against the base, m/s^2 in space
TWO = np.array([[0, 1, 0, 0], [-900, -2, 600, 1], [0, 0, 0, 1], [300, 0.5, -300, -0.5]])


def cubic(p, z, m, dt, out):
    out[0] -= p[0] * z[0] ** 3


def dry(p, z, m, dt, out):
    out[0] -= p[0] * math.tanh(z[0] / (0.05 + p[0] * dt))


class Spring:
    @staticmethod
    def f(t, x, u, p):
        return [x[1], -30 * x[0] - 0.8 * x[1] + 20 * u[0]]

    @staticmethod
    def h(t, x, u, p):
        return [x[0], -30 * x[0] - 0.8 * x[1] + 20 * u[0]]


@pytest.fixture
def measured(model):
    """Make a model whose second output is an acceleration, of matrices or code."""

    def make(plant=FORCED, unit="m/s^2", code=None):
        made = model(plant, code=code, sizes=(2, 1, 2))
        return replace(made, outputs=(Variable("place", "mm"), Variable("acceleration", unit)))

    return make


def played(model, run, effects, substeps=1):
    found = nominal(model, DT)
    return Simulator(found, np.zeros((2, 2)), substeps=substeps).run(run, np.zeros(len(found.entries)), np.zeros(2), effects).y


@pytest.mark.parametrize(("law", "size", "family"), [(cubic, 40.0, ""), (dry, 4.0, "friction")])
@pytest.mark.parametrize("kind", ["matrices", "code", "along the input"])
def test_an_accelerometer_reads_the_force_at_once(measured, recording, excitation, effect, law, size, family, kind):
    place = ("x", 0) if law is cubic else ("x", 1)
    acting = effect(law, "force", [place], [("x", 1)], [size], family=family)
    if kind == "along the input":
        acting = replace(acting, hypothesis=replace(acting.hypothesis, along=Signal("u", 0)))
    m = measured(None, code=Spring) if kind == "code" else measured()

    def force(x):
        return -size * x[0] ** 3 if law is cubic else -size * np.tanh(x[1] / 0.05)

    x, expected = np.zeros(2), []
    for u in excitation[:, 0]:
        expected.append([x[0], -SPRING * x[0] - DAMPER * x[1] + GAIN * u + force(x)])
        x = solve_ivp(lambda t, s, u=u: [s[1], -SPRING * s[0] - DAMPER * s[1] + GAIN * u + force(s)], (0, DT), x, rtol=1e-9, atol=1e-11).y[:, -1]
    whole, plain = np.array(expected), played(m, recording(excitation, 2), [])
    missed = np.linalg.norm(plain - whole, axis=0)
    assert (missed > 0.1 * np.linalg.norm(whole, axis=0)).all()
    coarse, fine = (np.linalg.norm(played(m, recording(excitation, 2), [acting], n) - whole, axis=0) / missed for n in (1, 8))
    assert (coarse < (0.03 if law is cubic else 0.15)).all()
    assert (fine < (1e-3 if law is cubic else 0.03)).all()


def test_a_controller_reads_the_force_of_the_step_before(measured, recording, excitation, effect):
    """The force after a sample is not known there yet; finer steps bring it nearer."""
    acting = effect(cubic, "force", [("x", 0)], [("x", 1)], [40.0])
    controller = StateSpace.gain(np.array([[0.0, -0.01]]), DT)
    m = replace(measured(), controller=controller)
    found = nominal(m, DT)
    run = recording(excitation, 2, W=excitation)
    apart = []
    for substeps in (1, 8):
        y = Simulator(found, np.zeros((2, 2)), substeps=substeps).run(run, np.zeros(len(found.entries)), np.zeros(2), [acting], closed=True)
        apart.append(np.abs(excitation[:, 0] - 0.01 * y.y[:, 1] - y.u[:, 0]).max() / np.abs(0.01 * y.y[:, 1]).max())
    assert 0.01 < apart[0] < 0.1
    assert apart[1] < apart[0] / 6


@pytest.mark.parametrize(("plant", "unit", "share"), [
    (FORCED, "m/s^2", 1.0), (ON_A_BASE, "m/s^2", 1e-3), (FORCED, "N", 0.0), (FORCED, "", 0.0), (ON_A_BASE, "mm", 0.0),
    (StateSpace(FORCED.A, FORCED.B, np.array([[1.0, 0], [-SPRING, 0]]), FORCED.D), "m/s^2", 0.0),  # the spring's part alone
    (StateSpace(FORCED.A, FORCED.B, np.round(FORCED.C, 0), FORCED.D), "m/s^2", 0.0),  # a damper of 1 is not one of 0.8
    (StateSpace.of([[0, 1], [-SPRING, 0]], [[0], [GAIN]], [[1, 0], [-SPRING, 0]]), "m/s^2", 0.0),  # a place, perhaps, in odd units
    (StateSpace.of([[0, 1], [-SPRING, 0]], [[0], [GAIN]], [[1, 0], [-SPRING, 0]], [[0], [GAIN]]), "m/s^2", 1.0),
])  # fmt: skip
def test_an_acceleration_is_known_by_its_unit_and_its_rows(measured, plant, unit, share):
    assert felt(measured(plant, unit), plant) == pytest.approx(np.array([[0, 0], [0, share]]))


def test_an_acceleration_may_be_a_sum_over_modes_and_a_coupled_mass_is_itself(model):
    states = tuple(Variable(f"{kind}{k}", rate_of=f"q{k}" if kind == "v" else None) for k in (1, 2) for kind in "qv")
    modes = np.array([[0, 1, 0, 0], [-400, -0.8, 0, 0], [0, 0, 0, 1], [0, 0, -2500, -3.0]])
    for A, row in ((modes, 0.7 * modes[1] - 0.2 * modes[3]), (TWO, TWO[1]), (TWO, TWO[3])):
        plant = StateSpace.of(A, [[0], [0.0], [0], [0.0]], [row])
        m = replace(model(plant), states=states, outputs=(Variable("a", "m/s^2"),))
        (found,) = felt(m, plant)
        assert found[[0, 2]] == pytest.approx([0, 0])
        assert found @ A == pytest.approx(row)


def test_a_sampled_plant_is_read_by_its_continuous_counterpart(measured):
    A, B, C, D, _ = cont2discrete((FORCED.A, FORCED.B, FORCED.C, FORCED.D), DT)
    plant = StateSpace(A, B, C, D, DT)
    assert felt(replace(measured(), plant=plant, sample_time=DT), plant) == pytest.approx(np.array([[0, 0], [0, 1.0]]), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(("plant", "free"), [
    (FORCED, {"A[2,1]", "A[2,2]", "B[2,1]"}), (ON_A_BASE, {"A[2,1]", "A[2,2]", "B[2,1]"}),
    (StateSpace(FORCED.A, FORCED.B, np.round(FORCED.C, 0), FORCED.D), {"A[2,1]", "A[2,2]", "B[2,1]", "C[2,1]", "D[2,1]"}),
    (StateSpace(FORCED.A, FORCED.B, FORCED.C, np.array([[0.0], [7.0]])), {"A[2,1]", "A[2,2]", "B[2,1]", "D[2,1]"}),  # a base that moves
])  # fmt: skip
def test_numbers_of_an_acceleration_are_those_of_its_velocity(measured, plant, free):
    found = nominal(measured(plant), DT)
    assert {e.name for e in found.entries} == free
    moved = found.at(np.linspace(1.0, 2.0, len(free)))
    tied = found.felt.any(1)
    assert not np.allclose(moved.A, plant.A)
    assert moved.C[tied] - plant.C[tied] == pytest.approx(found.felt[tied] @ (moved.A - plant.A))
    assert (moved.D != plant.D).any() == (plant is FORCED or "D[2,1]" in free)
    if plant is FORCED:
        assert moved.D - plant.D == pytest.approx(found.felt @ (moved.B - plant.B))


def test_a_sampled_plant_keeps_the_numbers_of_its_outputs(measured):
    A, B, C, D, _ = cont2discrete((FORCED.A, FORCED.B, FORCED.C, FORCED.D), DT)
    plant = StateSpace(A, B, C, D, DT)
    found = nominal(replace(measured(), plant=plant, sample_time=DT), DT)
    assert "C[2,1]" in {e.name for e in found.entries}
    assert np.array_equal(found.at(np.zeros(len(found.entries))).C, C)
