"""The CUSUM between bursts."""

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.detection import FalseAlarms
from afdsvc.detect.model_uncertainty import share_near_instability
from afdsvc.detect.thresholds.average_run_length import run_length
from afdsvc.detect.thresholds.regressor_information import excursion_steps, noise_driven
from afdsvc.detect.uncertain_parameters import uncertain_entries
from afdsvc.excite.design_sheet import design_sheet
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.excite.simulated_burst import faulty_loop, simulate_burst
from afdsvc.plugins.detectors.cusum import PassiveCusumDesign
from afdsvc.testing.machines import bearing_problem, with_rate
from benchmarks.detection.judged import shown
from benchmarks.detection.truth import machines
from benchmarks.detection.truth_problem import problem_of

DT = 2e-4


def quiet(problem, n, seed, severities=None, loop=None):
    v = np.random.default_rng(seed).normal(size=(n, 2)) @ np.linalg.cholesky(problem.covariance).T
    return simulate_burst(problem, np.zeros((n, 2)), v, severities or {}, loop)


def evidence(detector, record, size=1000, gap_at=None):
    state, found = detector.start(), []
    for block in record.blocks(size):
        state, new = detector.step(state, replace(block, gap=block.k0 == gap_at))
        found += new
    return found


def test_loop_noise_alone_gives_half_a_loss_away_within_seconds():
    problem = bearing_problem("lqg")
    found = evidence(PassiveCusumDesign().design(problem, {}), quiet(problem, 15_000, 1, {"horizontal_actuator": -0.5}))
    first = found[0]
    assert first.detected
    assert first.trustworthy
    assert first.k * DT < 1.0
    assert first.weights["horizontal_actuator"] + first.weights["horizontal_sensor"] > 0.99
    assert first.severity is None  # an estimate at the moment of the alarm is too severe on average: only a bound is reported
    assert -1 <= first.parts["bound.horizontal_actuator"] < -0.5
    assert len(found) == 1  # silent for ten seconds after an alarm


def test_run_length_is_the_one_promised():
    # one alarm in 4000 samples is promised; alarms within a million samples are counted, restarted after each
    problem = bearing_problem("lqg")
    wanted = 4000
    detector = PassiveCusumDesign().design(with_rate(problem, per_hour=3600 / (wanted * DT)), {"silence_seconds": 0.0})
    n, alarms = 600_000, 0
    loop = faulty_loop(problem, {})
    for seed in range(2):
        alarms += sum(e.detected for e in evidence(detector, quiet(problem, n, 50 + seed, loop=loop), 50_000))
    expected = 2 * n / wanted
    assert alarms == pytest.approx(expected, abs=2.58 * np.sqrt(expected) + 0.1 * expected)


def test_boundary_for_one_fault_is_that_of_the_run_length():
    problem = bearing_problem("lqg")
    detector = PassiveCusumDesign().design(problem, {"severity": -0.3})
    block = detector.test.block
    step = excursion_steps(noise_driven(problem), np.arange(1), np.array([-0.3]), block)[0]
    alone = block * run_length(0.3 * np.sqrt(block * 0.7986), detector.boundary, step=step)
    # four faults in two pairs of near twins: between two and three times as many alarms as one of them
    assert 1.9 < alone / (720 * 3600 / DT) < 4.0


def test_coloured_noise_is_reported_once_and_not_alarmed():
    problem = bearing_problem("lqg")
    record = quiet(problem, 20_000, 3)
    slow = record.r + 0.5 * np.vstack([np.zeros((1, 2)), record.r[:-1]])
    found = evidence(PassiveCusumDesign().design(problem, {}), replace(record, r=slow / np.sqrt(1.25)))
    assert len(found) >= 1
    assert not any(e.detected for e in found)
    assert "not white" in found[0].reason
    assert not found[0].trustworthy


def test_after_a_gap_the_filters_settle_before_anything_is_said():
    problem = bearing_problem("lqg")
    detector = PassiveCusumDesign().design(problem, {})
    record = quiet(problem, 6_000, 4, {"vertical_actuator": -0.6})
    first = evidence(detector, record, 500)[0].k
    later = evidence(detector, record, 500, gap_at=500 * (first // 500))
    assert later[0].k > 500 * (first // 500) + detector.gate.settle


def test_a_frozen_sensor_is_named():
    problem = bearing_problem("lqg")
    record = quiet(problem, 9_000, 5)
    y = record.y.copy()
    y[4000:, 0] = y[4000, 0]
    r = record.r.copy()
    r[4000:, 0] += 3.0
    found = evidence(PassiveCusumDesign().design(problem, {}), replace(record, y=y, r=r), 250)
    assert not found[0].detected
    assert any("sensor 'horizontal' stands still" in e.reason for e in found)


def doubts(problem, record, **settings):
    detector = PassiveCusumDesign().design(problem, {"gate_window": 1000, **settings})
    return sum(not e.trustworthy for e in evidence(detector, record, 5000)), detector


def test_a_healthy_machine_that_idles_is_doubted_as_rarely_as_promised():
    # the quiet data are tested four times a window: what is promised per hour counts, not the level of one test
    problem, n = bearing_problem("lqg"), 300_000
    record = quiet(problem, n, 11)
    found, detector = doubts(with_rate(problem, per_hour=0.01 * 3600 / (250 * DT)), record, gate_level=0.01)
    assert detector.doubt_level == pytest.approx(0.01)
    assert 2 <= found <= 0.01 * n / 250 + 2.58 * np.sqrt(0.01 * n / 250)
    rare, detector = doubts(problem, record)
    assert detector.doubt_level == pytest.approx(problem.false_alarms.per_hour * 250 * DT / 3600)
    assert rare == 0


def test_noise_a_tenth_larger_is_doubted_in_spite_of_that():
    problem = bearing_problem("lqg")
    louder = quiet(replace(problem, covariance=1.1**2 * problem.covariance), 20_000, 12)
    found, _ = doubts(problem, louder, gate_window=2500)
    assert found == 1


def uncertain(machine, sd, per_hour=1.0):
    entries = {"A": sd * np.abs(machine.A), "B": sd * np.abs(machine.B)}
    problem = problem_of(machine, FalseAlarms(1e-2, per_hour))
    pulled = uncertain_entries(problem.plant, entries, machine.dt)
    return replace(problem, uncertain=pulled, uncertainty=dict.fromkeys(pulled.fault_names, 1.0))


def margin(machine, A, B):
    observer = machine.A + machine.B @ machine.F + machine.L @ machine.C
    loop = np.block([[A, B @ machine.F], [-machine.L @ machine.C, observer]])
    return 1 - np.abs(np.linalg.eigvals(loop)).max()


@pytest.mark.parametrize(("name", "sd"), [("unstable", 0.005), ("unstable", 0.002), ("integrating", 0.005), ("integrating", 0.02)])
def test_the_share_of_machines_near_instability_is_that_of_drawn_ones(name, sd):
    machine, rng = next(m for m in machines() if m.name == name), np.random.default_rng(5)
    drawn = [[M * (1 + sd * rng.standard_normal(M.shape)) for M in (machine.A, machine.B)] for _ in range(4000)]
    counted = np.mean([margin(machine, *each) < margin(machine, machine.A, machine.B) / 2 for each in drawn])
    assert share_near_instability(uncertain(machine, sd)) == pytest.approx(counted, abs=0.01 + 0.15 * counted)


def test_where_the_stated_uncertainty_nearly_loses_the_loop_no_alarm_is_trusted_and_the_reason_said():
    machine, samples = next(m for m in machines() if m.name == "unstable"), 20_000
    problem = uncertain(machine, 0.005, 3600 / (samples * machine.dt))
    design = PassiveCusumDesign().design
    detector, sure = design(problem, {"silence_seconds": 0.0}), design(uncertain(machine, 0.0005), {"silence_seconds": 0.0})
    assert "21 % of the machines it allows" in detector.unpromised
    assert sure.unpromised == ""
    assert (detector.silence, sure.silence) == (samples, 0)
    slow = machine.A + 0.007 * np.abs(machine.A)  # near instability
    run = machine.run(np.random.default_rng(2), np.zeros((samples, machine.shape[1])), plant=(slow, machine.B))
    assert margin(machine, slow, machine.B) < margin(machine, machine.A, machine.B) / 2
    (found,) = shown(problem, [detector], run, None)
    assert [(e.detected, e.trustworthy) for e in found] == [(False, False)]
    assert found[0].reason == detector.unpromised
    burst = default_burst(problem_of(machine), problem.limits)
    alarms = dict.fromkeys(("matched_filter", "passive_cusum"), problem.false_alarms)
    assert design_sheet(problem, [burst], alarms, 1.0)["unpromised"] == detector.unpromised
    assert design_sheet(problem, [burst], {"matched_filter": problem.false_alarms}, 1.0)["unpromised"] == ""
