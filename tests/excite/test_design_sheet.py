"""The design sheet: its keys, its reasons, and that simulation agrees with what it says."""

import json
from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import FalseAlarms
from afdsvc.detect.features.demodulation import Basis, BasisSums, project
from afdsvc.detect.features.regressors import whitener
from afdsvc.detect.statistics.matched_filter import window
from afdsvc.excite.design_sheet import design_sheet
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.excite.simulated_burst import faulty_loop, simulate_burst
from afdsvc.lti.lft import FaultDirection, augment
from afdsvc.testing.machines import bearing_problem

ALARMS = {n: FalseAlarms(1e-3, 1 / 720) for n in ("matched_filter", "fault_curves", "regression", "cusum", "passive_cusum")}


@pytest.fixture(scope="module")
def small():
    """A burst too small to be sure of anything, and its sheet."""
    problem = bearing_problem("proportional")
    burst = default_burst(problem, problem.limits, output_amplitude=0.15)
    return problem, burst, design_sheet(problem, [burst], ALARMS, 100.0)


def test_the_documented_keys_are_there_and_finite(small):
    _, _, sheet = small
    text = json.loads(json.dumps(sheet, allow_nan=False))
    assert {"bursts", "false_alarms_per_hour", "thresholds", "faults"} <= set(text)
    assert {"input", "frequencies_rad_s", "amplitudes", "seconds", "peak_output"} <= set(text["bursts"][0])
    wanted = {"fault", "severity", "gain", "phase_deg", "p_detect", "smallest_detectable", "confused_with", "cramer_rao_sd"}
    assert all(wanted <= set(f) for f in text["faults"])
    assert set(text["thresholds"]) == set(ALARMS)
    assert text["false_alarms_per_hour"] == pytest.approx(4 * 0.1 + 1 / 720)


def test_published_gain_and_phase():
    # thesis, publication P5 (34): horizontal actuator at half its gain, 62 rad/s, alpha_h to r_h, k = 0.2
    problem = bearing_problem("proportional")
    burst = Burst("sine", 2, 12_500, 500, (Line(0, 62.0, 1.0),))
    entry = next(f for f in design_sheet(problem, [burst], {}, 1.0, [-0.5])["faults"] if f["fault"] == "horizontal_actuator")
    assert entry["gain"] == pytest.approx(0.98967, abs=1e-5)
    assert entry["phase_deg"] == pytest.approx(125.3, abs=0.05)


def standard_scores(problem, burst, severities, runs, seed):
    """Line coordinates z of many bursts, shape (runs, D)."""
    rng, found = np.random.default_rng(seed), []
    loop, Li = faulty_loop(problem, severities), whitener(problem.covariance)
    basis, (first, last) = Basis(tuple(sorted(line.omega for line in burst.lines))), window(burst)
    alpha = burst.play(problem.plant.dt)
    for _ in range(runs):
        v = rng.normal(size=(burst.samples, 2)) @ np.linalg.cholesky(problem.covariance).T
        r = simulate_burst(problem, alpha, v, loop=loop).r[first:last] @ Li.T
        sums = BasisSums.empty(basis, 2).add(basis, first, problem.plant.dt, r)
        found.append(project(sums, basis).z.ravel())
    return np.array(found)


def test_simulation_agrees_with_the_probability_of_detection(small):
    problem, burst, sheet = small
    from afdsvc.excite.expected_detection import burst_detection

    seen, h = burst_detection(problem, burst), sheet["thresholds"]["matched_filter"]
    for fault, severity in (("horizontal_actuator", -0.1), ("vertical_sensor", -0.1)):
        entry = next(f for f in sheet["faults"] if f["fault"] == fault and f["severity"] == severity)
        assert 0.05 < entry["p_detect"] < 0.95
        e = seen.wave(fault, severity).ravel()
        e = e / np.linalg.norm(e)
        z = standard_scores(problem, burst, {fault: severity}, 400, 1)
        rate = np.mean(z @ e > h)
        assert rate == pytest.approx(entry["p_detect"], abs=2.58 * np.sqrt(0.25 / 400))


def test_a_fault_nothing_reaches_and_one_nothing_shows_are_explained():
    problem = bearing_problem()
    g = problem.plant
    n, m, p = g.order, g.inputs, g.outputs
    zero = np.zeros
    idle = FaultDirection("idle", np.eye(n)[:, :1], zero((p, 1)), zero((1, n)), zero((1, m)), zero((1, 1)))
    mute = FaultDirection("mute", zero((n, 1)), zero((p, 1)), zero((1, n)), np.eye(m)[:1], zero((1, 1)))
    seen = FaultDirection("seen", g.B[:, :1], zero((p, 1)), zero((1, n)), np.eye(m)[:1], zero((1, 1)))
    odd = replace(problem, augmented=augment(g, [seen, idle, mute]))
    burst = Burst("b", 2, 5000, 250, (Line(0, 800.0, 5.0), Line(1, 900.0, 5.0)))
    reported = {u["fault"]: u["why"] for u in design_sheet(odd, [burst], {}, 1.0, [-0.5])["unseen"]}
    assert set(reported) == {"idle", "mute"}
    assert "reaches the signal" in reported["idle"]
    assert "reaches no output" in reported["mute"]


def test_what_the_burst_cannot_separate_is_said_beforehand(small):
    _, _, sheet = small
    assert "horizontal_actuator from horizontal_sensor" in sheet["isolation"]["not_separated"]
    assert {b["fault"] for b in sheet["blind_pairs"]} == {"horizontal_sensor", "vertical_sensor"}


def test_the_smallest_detectable_loss_is_detected_with_99_per_cent(small):
    problem, burst, sheet = small
    from afdsvc.excite.expected_detection import burst_detection

    seen = burst_detection(problem, burst)
    for f in sheet["faults"]:
        assert seen.detection(f["fault"], f["smallest_detectable"], seen.threshold(1e-3)) == pytest.approx(0.99, abs=1e-6)
