"""Units decide nothing: states, inputs and outputs in 1e-12 or 1e12 of a unit lead to the same decisions."""

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import FalseAlarms, ResidualBlock
from afdsvc.detect.features.noise_calibration import calibrate_noise
from afdsvc.excite.certificate import certificate
from afdsvc.excite.diagnosis_burst import Aim, default_burst
from afdsvc.excite.expected_detection import burst_detection
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.whitening import innovations
from afdsvc.plugins.manager import load
from benchmarks.detection.judged import judged
from benchmarks.detection.truth import machines
from benchmarks.detection.truth_problem import problem_of

BASE = {m.name: m for m in machines()}
UNITS = {"tiny states": (1e-12, 1, 1), "huge states": (1e12, 1, 1), "tiny signals": (1, 1e-12, 1e-12), "opposed": (1e9, 1e-9, 1e-12)}


def decided(base, scaled, kind, units):
    problem = problem_of(scaled, FalseAlarms(1e-2))
    size = float(base.spread()[1].max())
    burst = Burst("b", base.shape[1], 2000, 100, tuple(Line(i, w + 70.0 * i, 8 * size) for i in range(base.shape[1]) for w in (220.0, 610.0)), settle=100)
    return judged(base, problem, load().get("detectors", kind).design(problem, {}), burst, 3, {"a0": -0.12}, units=units)


@pytest.mark.parametrize("kind", ["matched_filter", "fault_curves", "regression", "iterated_regression", "cusum"])
@pytest.mark.parametrize("name", ["unstable", "direct feedthrough"])
def test_decisions(kind, name):
    machine = BASE[name]
    n, m, p = machine.shape
    before = decided(machine, machine, kind, (1.0, 1.0))
    for s, i, o in UNITS.values():
        scaled = machine.scaled(s * np.logspace(-0.5, 0.5, n), np.full(m, i), np.full(p, o))
        after = decided(machine, scaled, kind, (i, o))
        assert (after.detected, after.fault, after.reason) == (before.detected, before.fault, before.reason)
        assert after.statistic == pytest.approx(before.statistic, rel=1e-4)
        assert after.threshold == pytest.approx(before.threshold, rel=1e-3)  # found by sampling


@pytest.mark.parametrize("units", UNITS.values(), ids=list(UNITS))
@pytest.mark.parametrize("name", ["unstable", "process noise large"])
def test_alarms_and_doubts_between_bursts(name, units):
    machine, (s, i, o), loss = BASE[name], units, -0.02 if name == "unstable" else -0.4
    n, m, p = machine.shape
    run = machine.run(np.random.default_rng(5), np.zeros((12_000, m)), np.tile(np.r_[np.full(m, loss), np.zeros(p)], (12_000, 1)))
    found = []
    for one, (iu, ou) in ((machine, (1.0, 1.0)), (machine.scaled(s * np.logspace(-0.5, 0.5, n), np.full(m, i), np.full(p, o)), (i, o))):
        problem = problem_of(one, FalseAlarms(1e-2, per_hour=3600.0))
        u, y, beta = iu * run["u"], ou * run["y"], ou * run["beta"]
        r, _ = simulate(problem.innovations, np.hstack([y, u]))
        detector = load().get("detectors", "passive_cusum").design(problem, {"silence_seconds": 1.0})
        boundary = detector.boundary  # found by simulation: the same to a few per mille; decisions are compared at the very same one
        detector = replace(detector, test=replace(detector.test, boundary=found[0][1] if found else boundary))
        state, reported = detector.start(), []
        for k in range(0, len(u), 1000):
            state, evidence = detector.step(state, ResidualBlock(k, one.dt, *(x[k : k + 1000] for x in (r, beta, u, y, 0 * u))))
            reported += evidence
        found.append((reported, boundary))
    (before, low), (after, high) = found
    assert len(before) > 2
    assert high == pytest.approx(low, rel=0.01)
    assert [(e.k, e.detected, e.fault, e.trustworthy) for e in after] == [(e.k, e.detected, e.fault, e.trustworthy) for e in before]


@pytest.mark.parametrize("units", UNITS.values(), ids=list(UNITS))
def test_calibration(units):
    machine, (s, i, o) = BASE["process noise large"], units
    n, m, p = machine.shape
    found = []
    for one in (machine, machine.scaled(np.full(n, s), np.full(m, i), np.full(p, o))):
        run = one.run(np.random.default_rng(1), np.zeros((3000, m)))
        plant = StateSpace(one.A, one.B, one.C, one.D, one.dt)
        noise = calibrate_noise(plant, run["u"], run["y"])
        found.append(innovations(plant, noise.output_cov, noise.process_cov, noise.cross_cov).covariance)
    assert found[1] / o**2 == pytest.approx(found[0], rel=1e-3)


@pytest.mark.parametrize("units", UNITS.values(), ids=list(UNITS))
@pytest.mark.parametrize("name", ["unstable", "process noise large", "one input, three outputs"])
def test_design_and_certificate(name, units):
    machine, (s, i, o) = BASE[name], units
    n, m, p = machine.shape
    found = []
    for one in (machine, machine.scaled(s * np.logspace(-0.5, 0.5, n), np.full(m, i), np.full(p, o))):
        problem = problem_of(one)
        burst = default_burst(problem, problem.limits, 2.0, aim=Aim(severity=-0.2))
        seen = burst_detection(problem, burst)
        found.append((burst, certificate(problem, problem.limits, burst, -0.2), [seen.deflection(f, -0.05) for f in problem.fault_names]))
    (before, safe, shown), (after, same, seen) = found
    assert [(line.input, line.omega) for line in after.lines] == [(line.input, pytest.approx(line.omega)) for line in before.lines]
    assert [line.amplitude / i for line in after.lines] == pytest.approx([line.amplitude for line in before.lines], rel=1e-4)
    assert (same.limit, same.fault) == (safe.limit, safe.fault)
    assert same.factor == pytest.approx(safe.factor, rel=1e-4)
    assert seen == pytest.approx(shown, rel=1e-4)


@pytest.mark.parametrize("units", UNITS.values(), ids=list(UNITS))
def test_quiet_data_that_a_fault_explains(units):
    machine, (s, i, o) = BASE["process noise large"], units
    n, m, p = machine.shape
    found = []
    for one, (iu, ou) in ((machine, (1.0, 1.0)), (machine.scaled(s * np.logspace(-0.5, 0.5, n), np.full(m, i), np.full(p, o)), (i, o))):
        problem = problem_of(one, FalseAlarms(1e-2))
        burst = Burst("b", m, 2000, 100, tuple(Line(k, w, 6.0) for k, w in enumerate((220.0, 610.0))), settle=60)
        detector = load().get("detectors", "regression").design(problem, {})
        found.append(judged(machine, problem, detector, burst, 1, {"s0": -0.2}, units=(iu, ou)))
    before, after = found
    assert (after.detected, after.fault, after.trustworthy) == (before.detected, before.fault, before.trustworthy) == (True, "s0", True)
    assert after.p_white == pytest.approx(before.p_white, rel=0.05)
