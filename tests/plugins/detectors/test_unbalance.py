"""Machines out of balance: trusted, alarms as promised, faults found."""

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.bursts import Limits
from afdsvc.api.detection import DetectionProblem, FalseAlarms
from afdsvc.excite.diagnosis_burst import Aim, default_burst
from afdsvc.excite.simulated_burst import SimulatedBurst, played
from afdsvc.lti.lft import star
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.whitening import innovations, whitening_filter
from afdsvc.plants.amb_turboexpander import amb_turboexpander
from afdsvc.plugins.controllers.lqg import Lqg
from afdsvc.plugins.detectors import afdsvc_detectors
from afdsvc.testing.machines import bearing_problem, with_rate

DESIGNS = {d.name: d for d in afdsvc_detectors()}
AWARE = ["matched_filter", "fault_curves", "regression", "cusum"]
QUIET, SPEED = 3000, 2 * np.pi * 1100 / 60


def shaken_loop(problem, severities):
    """The loop from ``[v, force, alpha]`` to ``[u, y]``; the force enters where the input does but is not part of u."""
    g = problem.augmented.close(severities)
    n, m, p = g.order, g.inputs, g.outputs
    B = np.hstack([np.zeros((n, p)), g.B, g.B])
    C, D = np.vstack([np.zeros((m, n)), g.C, g.C]), np.zeros((m + 2 * p, p + 2 * m))
    D[:m, p + m :], D[m + p :, :p] = np.eye(m), np.eye(p)
    return star(StateSpace(g.A, B, C, D, g.dt), problem.interconnection, p, m)


def turning(problem, burst, force, speed, severities, seed, runout=0.0):
    """Blocks of a burst on a rotor that ``force`` (complex, per input) shakes, with sensors that also see its ``runout``."""
    dt, alpha, m = problem.plant.dt, played(burst, problem.plant.dt, QUIET, 20), problem.plant.inputs
    angle = speed * np.arange(len(alpha)) * dt
    bent = runout * np.sin(2 * angle + 0.4)[:, None] * np.ones(problem.plant.outputs)
    v = np.random.default_rng(seed).normal(size=bent.shape) @ np.linalg.cholesky(problem.output_cov).T + bent
    shake = np.real(np.exp(1j * angle)[:, None] * force[None, :])
    out, _ = simulate(shaken_loop(problem, severities), np.hstack([v, shake, alpha]))
    u, y = out[:, :m], out[:, m : m + v.shape[1]] + v
    r, _ = simulate(problem.innovations, np.hstack([y, u]))
    for block in SimulatedBurst(dt, r, y, u, alpha, v).blocks(2500, burst, QUIET):
        yield replace(block, aux={"angle": angle[block.k0 : block.k0 + len(block)][:, None]})


def reported(detector, blocks):
    state, found = detector.start(), []
    for block in blocks:
        state, evidence = detector.step(state, block)
        found += evidence
    return found


@pytest.fixture(scope="module")
def bearing():
    """The gas bearing at 1100 rpm, shaken by ten standard deviations of its noise."""
    problem = bearing_problem("lqg", 1100)
    unit = np.abs(simulate(problem.plant, np.cos(SPEED * np.arange(5000) * 2e-4)[:, None] * np.ones(2))[0]).max()
    force = 10 * np.sqrt(problem.covariance[0, 0]) / unit * np.array([1.0, -1.0j])
    return problem, default_burst(problem, problem.limits, 0.8, 1.0), force


@pytest.mark.parametrize("name", AWARE)
def test_unbalance_is_no_reason_for_distrust_nor_for_an_alarm(name, bearing):
    problem, burst, force = bearing
    (found,) = reported(DESIGNS[name].design(problem, {}), turning(problem, burst, force, SPEED, {}, 1, runout=2.0))
    assert found.trustworthy, found.reason
    assert not found.detected


def test_without_a_rotor_angle_unbalance_is_distrusted(bearing):
    problem, burst, force = bearing
    blocks = (replace(b, aux={}) for b in turning(problem, burst, force, SPEED, {}, 1))
    (found,) = reported(DESIGNS["regression"].design(problem, {}), blocks)
    assert not found.trustworthy
    assert "during the burst the residual beside its lines" in found.reason


@pytest.mark.parametrize("name", AWARE)
@pytest.mark.parametrize("fault", ["horizontal_actuator", "vertical_sensor"])
def test_faults_are_found_beside_unbalance(name, fault, bearing):
    problem, burst, force = bearing
    (found,) = reported(DESIGNS[name].design(problem, {}), turning(problem, burst, force, SPEED, {fault: -0.5}, 2))
    assert found.trustworthy, found.reason
    assert found.detected
    if name == "cusum":
        assert found.parts[f"bound.{fault}"] < -0.5
    else:
        assert abs(found.parts[f"severity.{fault}"] + 0.5) < 4 * found.parts[f"sd.{fault}"]


def rate(problem, burst, force, speed, name, runs, per_burst):
    detector = DESIGNS[name].design(with_rate(problem, per_burst=per_burst), {"gate_level": 1e-9})
    found = [reported(detector, turning(problem, burst, force, speed, {}, seed))[0] for seed in range(runs)]
    assert all(e.trustworthy for e in found)
    return np.mean([e.detected for e in found])


@pytest.mark.parametrize(("name", "runs"), [("regression", 60), *(pytest.param(n, 600, marks=pytest.mark.long) for n in AWARE)])
def test_the_alarm_rate_is_kept_beside_unbalance(name, runs, bearing):
    found = rate(*bearing, SPEED, name, runs, 0.1)
    assert found == pytest.approx(0.1, abs=2.58 * np.sqrt(0.09 / runs))


def test_the_passive_detector_does_not_alarm_on_unbalance(bearing):
    problem, burst, force = bearing
    detector = DESIGNS["passive_cusum"].design(problem, {})
    silent = replace(burst, lines=())
    healthy = [replace(b, burst=None) for b in turning(problem, silent, force, SPEED, {}, 3)]
    assert reported(detector, healthy) == []
    faulty = [replace(b, burst=None) for b in turning(problem, silent, force, SPEED, {"horizontal_sensor": -0.6}, 4)]
    first = reported(detector, faulty)[0]
    assert first.trustworthy
    assert first.detected


@pytest.fixture(scope="module")
def turboexpander():
    """The turboexpander at speed with the unbalance of its balancing grade."""
    plant = amb_turboexpander()
    G = plant.discrete()
    design = Lqg().design(G, plant.recommended["lqg"])
    residual = innovations(G, plant.output_cov)
    limits = Limits(plant.output_limit, plant.input_limit, 10 * plant.input_limit)
    problem = DetectionProblem(
        "turboexpander", G, plant.faults(), design.interconnection, residual.filter,
        whitening_filter(design.factorisation, plant.output_cov)[0], residual.covariance,
        tuple(v.name for v in plant.outputs), FalseAlarms(1e-3), tuple(v.name for v in plant.inputs), limits=limits,
        output_cov=plant.output_cov,
    )  # fmt: skip
    return problem, default_burst(problem, limits, 0.6, aim=Aim(severity=-0.2)), plant.unbalance, plant.speed


@pytest.mark.parametrize("name", ["matched_filter", "regression", pytest.param("fault_curves", marks=pytest.mark.long)])
def test_the_turboexpander_with_unbalance(name, turboexpander):
    problem, burst, force, speed = turboexpander
    assert np.abs(force).max() > 0
    detector = DESIGNS[name].design(problem, {})
    (healthy,) = reported(detector, turning(problem, burst, force, speed, {}, 5))
    assert healthy.trustworthy, healthy.reason
    assert not healthy.detected
    fault = problem.fault_names[0]
    (faulty,) = reported(detector, turning(problem, burst, force, speed, {fault: -0.2}, 6))
    assert faulty.detected, faulty.reason


@pytest.mark.parametrize("name", ["chi_square", "limit_check", "published_a0", "model_bank", "iterated_regression"])
def test_detectors_to_compare_with_trust_a_machine_out_of_balance_and_stay_quiet(name, bearing):
    problem, burst, force = bearing
    found = reported(DESIGNS[name].design(problem, {}), turning(problem, burst, force, SPEED, {}, 5, runout=1.0))
    assert all(e.trustworthy for e in found), found[0].reason
    assert not any(e.detected for e in found)


def test_a_fault_is_found_beside_unbalance_by_iterated_regression(bearing):
    problem, burst, force = bearing
    severities = {"horizontal_actuator": -0.3}
    found, *_ = reported(DESIGNS["iterated_regression"].design(problem, {}), turning(problem, burst, force, SPEED, severities, 6, runout=1.0))
    assert found.detected
    assert found.weights["horizontal_actuator"] + found.weights["horizontal_sensor"] > 0.95
