"""The noise found from quiet data: against the truth, and trusted by the gate on the data that follow."""

import numpy as np
import pytest

from afdsvc.detect.features.innovations import ResidualFilter
from afdsvc.detect.features.noise_calibration import calibrate_noise
from afdsvc.detect.features.whiteness_gate import Gate
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.whitening import innovations
from benchmarks.detection.truth import machines

MACHINES = {m.name: m for m in machines()}
QUIET = 6000


def calibrated(machine, seed, noisier=1.0):
    """Return the innovations of the noise found, and the gate's judgement of 3000 further samples."""
    n, m, p = machine.shape
    scale = np.r_[np.ones(QUIET), np.full(3000, noisier)]
    run = machine.run(np.random.default_rng(seed), np.zeros((QUIET + 3000, m)), noisier=scale)
    plant = StateSpace(machine.A, machine.B, machine.C, machine.D, machine.dt)
    noise = calibrate_noise(plant, run["u"][:QUIET], run["y"][:QUIET])
    found = innovations(plant, noise.output_cov, noise.process_cov, noise.cross_cov)
    r = ResidualFilter(found.filter).step(np.zeros(n), run["y"], run["u"])[1]
    e = np.linalg.solve(np.linalg.cholesky(found.covariance), r[QUIET:].T).T
    gate = Gate(estimated=noise.samples)
    return found, gate.judge(gate.add(gate.start(0, p), e[:, None]))


@pytest.mark.parametrize("name", MACHINES)
def test_the_next_quiet_data_are_trusted_and_louder_ones_are_not(name):
    assert sum(calibrated(MACHINES[name], seed)[1].ok for seed in range(5)) >= 4
    assert not any(calibrated(MACHINES[name], seed, 1.1)[1].ok for seed in range(2))


@pytest.mark.parametrize("name", ["process noise large", "one input, three outputs", "unstable"])
def test_covariance_and_gain_are_those_of_the_machine(name):
    machine = MACHINES[name]
    found, _ = calibrated(machine, 11)
    true = innovations(StateSpace(machine.A, machine.B, machine.C, machine.D, machine.dt), machine.R, machine.Q)
    root = np.linalg.inv(np.linalg.cholesky(true.covariance))
    assert np.abs(root @ found.covariance @ root.T - np.eye(len(root))).max() < 5 * np.sqrt(2 / QUIET)
    # The predictor matters through what it makes of the true innovations: white but for a share that the data cannot show.
    left, A = 0.0, machine.A - found.gain @ machine.C
    x = (true.gain - found.gain) @ np.linalg.inv(root)
    for _ in range(400):
        left, x = left + float(np.sum((root @ machine.C @ x) ** 2)), A @ x
    assert left < 3 * found.gain.size / QUIET


def test_too_few_samples_and_a_sensor_that_does_not_change_are_refused():
    plant = StateSpace(np.array([[0.9]]), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)), 1e-3)
    with pytest.raises(BadInput, match="499 quiet samples"):
        calibrate_noise(plant, np.zeros((499, 1)), np.zeros((499, 1)))
    with pytest.raises(BadInput, match="output 0 does not change"):
        calibrate_noise(plant, np.zeros((600, 1)), np.ones((600, 1)))
