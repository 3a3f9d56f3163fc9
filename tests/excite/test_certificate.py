"""Bursts that are safe before they are played: against the truth simulator, transients and noise included."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import FalseAlarms
from afdsvc.detect.uncertain_parameters import uncertain_entries
from afdsvc.errors import Refused
from afdsvc.excite.certificate import certificate
from afdsvc.excite.diagnosis_burst import Aim, default_burst
from afdsvc.excite.settings import BURST
from afdsvc.plugins.manager import load
from benchmarks.detection.certificates import given_up
from benchmarks.detection.judged import judged
from benchmarks.detection.truth import TrueMachine, machines
from benchmarks.detection.truth_problem import alpha_of, loss_of, problem_of

MACHINES = {m.name: m for m in machines()}


def ringing(radius: float) -> TrueMachine:
    """An oscillator that a weak controller leaves ringing."""
    c, s = radius * np.cos(0.3), radius * np.sin(0.3)
    A, B, C = np.array([[c, s], [-s, c]]), np.array([[0.0], [1.0]]), np.eye(2)
    return TrueMachine("ringing", A, B, C, np.zeros((2, 1)), np.array([[0.0, -1e-4]]), -0.05 * np.eye(2), 1e-4 * np.eye(2), 0.01 * np.eye(2))


@pytest.mark.parametrize("name", ["order 8, process noise small", "process noise large", "unstable", "one input, three outputs", "ringing"])
def test_no_limit_is_passed_with_any_fault(name):
    machine = ringing(0.99) if name == "ringing" else MACHINES[name]
    problem, aim = problem_of(machine, room=9.0), Aim(severity=-0.3)
    burst = default_burst(problem, problem.limits, 2.0, 1e3 * float(problem.limits.output.max()), aim)  # as large as may be
    assert certificate(problem, problem.limits, burst, -0.3).factor >= 1 - 1e-9
    assert "% of the room below the limit of" in burst.notes["certificate"]
    for k, fault in enumerate([None, *problem.fault_names]):
        loss = None if fault is None else loss_of(problem, {fault: -0.3 if machine.name != "unstable" else -0.02})
        y = machine.run(np.random.default_rng(k), alpha_of(burst, machine.dt, 500), loss)["y"]
        assert (np.abs(y) <= problem.limits.output).all()


def test_a_transient_counts_and_not_only_the_steady_line():
    problem = problem_of(ringing(0.999))
    line = Line(0, 280.0, 1.0)  # beside the resonance: beats for longer than the ramp
    burst = Burst("b", 1, 3000, 20, (line,))
    limits = replace(problem.limits, input=np.full(1, 1e9), alpha=np.full(1, 1e9))
    found = certificate(problem, limits, burst, -0.1)
    steady = certificate(problem, limits, replace(burst, samples=6000, ramp=2900), -0.1)
    assert found.factor < 0.8 * steady.factor


def test_noise_that_fills_a_limit_is_refused_by_name():
    machine = MACHINES["process noise large"]
    problem = problem_of(machine, room=5.0)
    with pytest.raises(Refused, match="noise alone reaches the limit of output 'y"):
        certificate(problem, problem.limits, Burst("b", 2, 1000, 50, (Line(0, 300.0, 1.0),)), -0.5)


def test_a_loop_that_rings_through_the_burst_is_refused_in_words():
    problem = problem_of(ringing(0.997))
    with pytest.raises(Refused, match=r"the loop rings for .* expected a burst of at least"):
        default_burst(problem, problem.limits, 1.5, aim=Aim(severity=-0.3))
    longer = default_burst(problem, problem.limits, 6.0, aim=Aim(severity=-0.3))
    assert longer.settle > 0.2 * longer.samples


@pytest.mark.parametrize("kind", ["matched_filter", "regression"])
def test_losses_on_a_ringing_machine_are_named_and_inside_their_intervals(kind):
    machine = ringing(0.997)
    problem = problem_of(machine, FalseAlarms(1e-2))
    burst = default_burst(problem, problem.limits, 6.0, aim=Aim(severity=-0.3))
    detector = load().get("detectors", kind).design(problem, {})
    found = [(fault, judged(machine, problem, detector, burst, seed, {fault: -0.3})) for fault in problem.fault_names for seed in range(8)]
    assert sum(e.fault == fault for fault, e in found) >= 22
    assert sum(e.severity.low <= -0.3 <= e.severity.high for _, e in found) >= 21
    assert np.mean([e.severity.value for _, e in found]) == pytest.approx(-0.3, abs=0.02)


def test_uncertain_parameters_leave_less_room_and_every_machine_they_may_be_keeps_the_limits():
    machine = MACHINES["order 8, process noise small"]
    problem = problem_of(machine, room=9.0)
    entries = uncertain_entries(problem.plant, {"A": 0.01 * np.abs(machine.A), "B": 0.05 * np.abs(machine.B)}, machine.dt)
    doubtful = replace(problem, uncertain=entries, uncertainty=dict.fromkeys(entries.fault_names, 1.0))
    limits = replace(problem.limits, input=1e9 * problem.limits.input)
    burst = Burst("b", 2, 1500, 75, (Line(0, 300.0, 1.0), Line(1, 420.0, 1.0, 1.0)))
    certain, found = (certificate(p, limits, burst, -0.3).factor for p in (problem, doubtful))
    assert 0.3 * certain < found < 0.98 * certain
    alpha, rng = found * alpha_of(burst, machine.dt, 300), np.random.default_rng(0)
    for k in range(10):
        A, B = (M * (1 + share * rng.normal(size=M.shape)) for M, share in ((machine.A, 0.01), (machine.B, 0.05)))
        other = replace(machine, A=A, B=B)
        y = controlled(other, machine, alpha, k)
        assert (np.abs(y) <= problem.limits.output).all()


def controlled(true: TrueMachine, nominal: TrueMachine, alpha: np.ndarray, seed: int) -> np.ndarray:
    """Return the outputs of a machine in the loop of the controller that was made for another."""
    rng, y = np.random.default_rng(seed), np.zeros((len(alpha), len(true.C)))
    x, h = np.zeros(len(true.A)), np.zeros(len(true.A))
    Q, R = (np.linalg.cholesky(cov + 1e-15 * np.eye(len(cov))) for cov in (true.Q, true.R))
    for k in range(len(alpha)):
        u = nominal.F @ h + alpha[k]
        y[k] = true.C @ x + true.D @ u + R @ rng.normal(size=len(R))
        beta = y[k] - nominal.C @ h - nominal.D @ u
        x, h = true.A @ x + true.B @ u + Q @ rng.normal(size=len(Q)), nominal.A @ h + nominal.B @ u - nominal.L @ beta
    return y


def test_noise_on_the_largest_burst_passes_a_limit_as_often_as_is_allowed(monkeypatch):
    machine, allowed = MACHINES["unstable"], 2 * norm.sf(2.5)
    monkeypatch.setattr("afdsvc.excite.certificate.BURST", replace(BURST, noise_peak=2.5))  # a rate that can be counted
    problem = problem_of(machine, room=6.0)
    burst = Burst("b", 1, 1500, 75, (Line(0, 300.0, 1.0), Line(0, 470.0, 1.0, 1.0)))
    factor, rng = certificate(problem, problem.limits, burst, -1e-6).factor, np.random.default_rng(0)
    alpha = factor * alpha_of(burst, machine.dt, 300)
    passed = [(np.abs(machine.run(rng, alpha)["y"][300:]) > problem.limits.output).mean() for _ in range(200)]
    assert 0.9 * allowed < np.mean(passed) < 1.1 * allowed


@pytest.mark.parametrize("seconds", [2.0, 6.0])
def test_near_the_loss_of_the_loop_a_designed_burst_gives_up_at_most_a_fifth_of_its_power(seconds):
    assert given_up(MACHINES["unstable"], seconds) < 0.2
