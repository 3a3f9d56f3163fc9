"""PBSIDopt: right where feedback makes open-loop methods wrong."""

import numpy as np
import pytest

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput
from afdsvc.identify.methods.pbsid import decompose_predictor, realise_predictor
from afdsvc.identify.methods.subspace import decompose, realise
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace

OMEGA = np.linspace(0.01, 3.1, 80)


def _feedback_record(system, gain, seed, samples, noise, pole):
    """u = r - gain y_m with a first-order disturbance on every output."""
    rng = np.random.default_rng(seed)
    p = system.outputs
    r, e = rng.standard_normal((samples, system.inputs)), noise * rng.standard_normal((samples, p))
    n = system.order
    A = np.block([[system.A - gain * system.B @ system.C, -gain * system.B], [np.zeros((p, n)), pole * np.eye(p)]])
    B = np.block([[system.B, np.zeros((n, p))], [np.zeros((p, system.inputs)), np.eye(p)]])
    y, _ = simulate(StateSpace(A, B, np.hstack([system.C, np.eye(p)]), np.zeros((p, 2 * p)), 1.0), np.hstack([r, e]))
    return InputOutputData.of(r - gain * y, y, 1.0)


def _error(found, system):
    truth = frequency_response(system, OMEGA)
    return np.median(np.abs(frequency_response(found, OMEGA) - truth).max(axis=(1, 2))) / np.abs(truth).max()


def test_consistent_in_closed_loop_where_moesp_is_not(oscillators):
    system = oscillators(21)
    records = [_feedback_record(system, 0.05, 3, n, 0.5, 0.98) for n in (5_000, 80_000)]
    ours = [_error(realise_predictor(decompose_predictor([r], 60), 8).system, system) for r in records]
    moesp = [_error(realise(decompose([r], 20), 6).system, system) for r in records]
    assert ours[1] < 0.002 < moesp[1]
    assert ours[1] < 0.5 * ours[0]
    assert moesp[1] > 0.7 * moesp[0]  # a bias does not shrink


def test_unstable_plant_is_found_in_its_loop():
    rng = np.random.default_rng(5)
    samples = 20_000
    u, y, x = np.zeros((samples, 1)), np.zeros((samples, 1)), np.zeros(2)
    A, B, C = np.array([[1.1, 0.2], [0, 0.6]]), np.array([1.0, 0.5]), np.array([1.0, 0.0])
    r, v = rng.standard_normal(samples), 0.1 * rng.standard_normal(samples)
    for k in range(samples):
        y[k] = C @ x + v[k]
        u[k] = -0.5 * y[k] + r[k]
        x = A @ x + B * u[k, 0]
    model = realise_predictor(decompose_predictor([InputOutputData.of(u, y, 1.0)], 30), 2)
    assert np.sort(model.system.poles().real) == pytest.approx([0.6, 1.1], abs=0.01)
    assert model.covariance[0, 0] == pytest.approx(0.01 * 1.1**2, rel=0.03)  # det Xi / det Rv = prod |unstable poles|^2


def test_gain_makes_the_errors_white_and_of_the_stated_covariance(oscillators):
    from afdsvc.stats.portmanteau import portmanteau_test

    system = oscillators(22)
    record = _feedback_record(system, 0.05, 6, 30_000, 0.5, 0.9)
    model = realise_predictor(decompose_predictor([record], 60), 8)
    errors = model.errors(record.u, record.y)[200:]
    assert portmanteau_test(errors) > 1e-3
    assert np.allclose(errors.T @ errors / len(errors), model.covariance, rtol=0.03, atol=0.01)
    assert np.allclose(np.diag(model.covariance), 0.25, rtol=0.05)


def test_direct_feedthrough_is_found_when_allowed(oscillators):
    rng = np.random.default_rng(7)
    plain = oscillators(23)
    system = StateSpace(plain.A, plain.B, plain.C, np.array([[1.0, -2.0], [0.5, 3.0]]), 1.0)
    u = rng.standard_normal((20_000, 2))
    y = simulate(system, u)[0] + 0.1 * rng.standard_normal((20_000, 2))
    model = realise_predictor(decompose_predictor([InputOutputData.of(u, y, 1.0)], 40, feedthrough=True), 6)
    assert np.allclose(model.system.D, system.D, atol=0.02)
    assert _error(model.system, system) < 0.01


def test_bad_windows_are_named(oscillators):
    record = _feedback_record(oscillators(21), 0.05, 3, 2_000, 0.5, 0.9)
    with pytest.raises(BadInput, match="past window 1 and future window 2"):
        decompose_predictor([record], 1)
    with pytest.raises(BadInput, match="order 90"):
        realise_predictor(decompose_predictor([record], 20), 90)
