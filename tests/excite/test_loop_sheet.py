"""The sheet of the loop: against printed numbers of the thesis, a simulation, and what its words promise."""

from __future__ import annotations

import json

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.excite.loop_sheet import (
    candidate_frequencies,
    controller_gain,
    disturbance_gain,
    gaps,
    least_damping,
    loop_poles,
    loop_sheet,
)
from afdsvc.lti.simulate import simulate
from afdsvc.lti.stability import closed_loop_matrix
from afdsvc.lti.statespace import StateSpace
from afdsvc.testing.machines import bearing_problem, unstable_problem

PROPORTIONAL = StateSpace.gain(0.2 * np.eye(2), 2e-4)


@pytest.fixture(scope="module")
def bearing():
    problem = bearing_problem("proportional")
    return problem, default_burst(problem, problem.limits)


def test_published_phase_and_amplitude(bearing):
    # thesis, publication P5 (34): horizontal actuator at half its gain, 62 rad/s, alpha_h to r_h, k = 0.2
    found = loop_sheet(*bearing, PROPORTIONAL, [62.0])["candidates"]
    assert [(c["rad_s"], c["input"]) for c in found] == [(62.0, "horizontal"), (62.0, "vertical")]
    seen, k = found[0]["faults"]["horizontal_actuator"]["horizontal"], found[0]["severities"].index(-0.5)
    assert seen["amplitude"][k] == pytest.approx(0.98967, abs=1e-4)
    assert seen["phase_deg"][k] == pytest.approx(125.3, abs=0.05)


def test_published_root_locus(bearing):
    # docs/explanation/errata.md: P5's loop is stable for -0.132 < k < 0.407
    found = controller_gain(bearing[0].plant, PROPORTIONAL)
    assert 0.2 * found["stable_from"] == pytest.approx(-0.132, abs=1e-3)
    assert 0.2 * found["stable_to"] == pytest.approx(0.407, abs=1e-3)
    assert found["least_damping"] == pytest.approx(0.246, abs=1e-3)
    assert found["best_damping"] > found["least_damping"]


def test_a_loop_needs_its_controller_where_the_plant_is_unstable():
    problem = unstable_problem()
    K = problem.interconnection.select(range(problem.plant.inputs), range(problem.plant.outputs))
    found = controller_gain(problem.plant, K)
    assert found["stable_from"] > 0
    for factor, stable in ((found["stable_from"] - 1e-3, False), (found["stable_from"] + 1e-3, True)):
        assert (np.abs(loop_poles(problem.plant, K, [factor])).max() < 1) == stable


def test_damping_is_that_of_the_poles():
    dt, zeta, w = 1e-3, 0.3, 50.0
    s = np.array([-zeta + 1j * np.sqrt(1 - zeta**2), -zeta - 1j * np.sqrt(1 - zeta**2)]) * w
    assert least_damping(np.exp(dt * s), dt) == pytest.approx(zeta)
    assert least_damping(np.exp(dt * np.array([1 + 3j, 1 - 3j])), dt) < 0


def test_branches_follow_their_poles(bearing):
    branches = loop_poles(bearing[0].plant, PROPORTIONAL, np.linspace(0, 2, 201))
    assert np.abs(np.diff(branches, axis=0)).max() < 0.02


def test_disturbance_gain_is_what_a_simulated_sine_shows(bearing):
    plant, omega = bearing[0].plant, 300.0
    without, within = disturbance_gain(plant, PROPORTIONAL, [omega])
    t = plant.dt * np.arange(60_000)
    for gain, controlled in ((without, 0.0), (within, 1.0)):
        loop = StateSpace.of(plant.A + plant.B @ (0.2 * controlled * plant.C), plant.B, plant.C, None, plant.dt)
        at = np.exp(-1j * omega * t[-plant.order * 5000 :])
        columns = []
        for j in range(2):
            d = np.zeros((len(t), 2))
            d[:, j] = np.sin(omega * t)
            y = simulate(loop, d)[0][-len(at) :]
            columns.append(2 * (at @ y) / len(at))
        assert np.linalg.norm(np.array(columns).T, 2) == pytest.approx(gain[0], rel=0.01)


def test_a_fault_whose_gap_is_below_the_margin_leaves_the_loop_stable_and_may_be_found_all_the_same(bearing):
    problem, burst = bearing
    found = gaps(problem, PROPORTIONAL)
    small = [(n, s) for n, values in found["faults"].items() for s, gap in zip(found["severities"], values, strict=True) if gap < found["margin"]]
    assert small
    for name, severity in small:
        faulty = problem.augmented.close({name: severity})
        assert np.abs(np.linalg.eigvals(closed_loop_matrix(faulty, PROPORTIONAL))).max() < 1
    # its limits: actuator and sensor of one axis have one gap, and so have bursts that find them and bursts that do not
    actuator, sensor = (np.array(found["faults"][f"horizontal_{part}"]) for part in ("actuator", "sensor"))
    np.testing.assert_allclose(actuator, sensor, rtol=1e-3)


def test_candidates(bearing):
    problem, burst = bearing
    assert {line.omega for line in burst.lines} <= set(candidate_frequencies(problem, burst))
    assert list(candidate_frequencies(problem, burst, [300.0, 62.0])) == [62.0, 300.0]
    with pytest.raises(BadInput, match="between 0 and 15708"):
        candidate_frequencies(problem, burst, [2e4])


def test_it_is_a_document(bearing):
    sheet = json.loads(json.dumps(loop_sheet(*bearing, PROPORTIONAL), allow_nan=False))
    assert set(sheet) == {"candidates", "nu_gap", "controller_gain"}
    assert set(sheet["nu_gap"]["faults"]) == set(bearing[0].fault_names)
