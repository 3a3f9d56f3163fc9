"""Subspace identification: exact without noise, consistent with it, whatever weighting, units, or number of recordings."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput
from afdsvc.identify.methods.subspace import WEIGHTINGS, decompose, realise, stable_transition
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace

OMEGA = np.linspace(0.01, 3.1, 80)


def _record(system, seed, samples, noise=0.0, scale=1.0):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((samples, system.inputs)) * scale
    y, _ = simulate(system, u, 0.5 * rng.standard_normal(system.order))
    return InputOutputData.of(u, y + noise * y.std(axis=0) * rng.standard_normal(y.shape), system.dt)


def _error(found, system):
    truth = frequency_response(system, OMEGA)
    return np.abs(frequency_response(found, OMEGA) - truth).max() / np.abs(truth).max()


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@given(seed=st.integers(0, 10**6), order=st.integers(2, 8), m=st.integers(1, 3), p=st.integers(1, 3))
@settings(max_examples=12, deadline=None)
def test_noise_free_recordings_give_the_system_back(oscillators, weighting, seed, order, m, p):
    system = oscillators(seed, order, m, p)
    system = StateSpace(system.A, system.B, system.C, np.random.default_rng(seed).standard_normal((p, m)), 1.0)
    recordings = [_record(system, seed + 1, 900), _record(system, seed + 2, 700)]
    model = realise(decompose(recordings, 10, weighting), order)
    # PI-MOESP drops what the unknown initial state leaves behind, which dies out only over the horizon
    assert _error(model.system, system) < (1e-2 if weighting == "pi-moesp" else 1e-7)


def test_singular_values_end_at_the_order(oscillators):
    values = decompose([_record(oscillators(3), 4, 3000, noise=1e-3)], 12).singular_values
    assert values[5] > 50 * values[6]
    assert values[6] < 3 * values[8]


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_error_falls_with_the_square_root_of_the_samples(oscillators, weighting):
    system = oscillators(5)
    errors = [
        np.median(
            [
                _error(realise(decompose([_record(system, s, n, 0.1)], 20, weighting), 6).system, system)
                for s in range(6)
            ]
        )
        for n in (2_000, 50_000)
    ]
    assert 3.0 < errors[0] / errors[1] < 9.0  # sqrt(25) = 5


def test_units_do_not_matter(oscillators):
    system = oscillators(6)
    r = _record(system, 1, 4000, 0.05)
    rescaled = InputOutputData.of(r.u * np.array([1e6, 1e-3]), r.y * np.array([1e-6, 1e4]), 1.0)
    plain, other = realise(decompose([r], 15), 6).system, realise(decompose([rescaled], 15), 6).system
    back = StateSpace(
        other.A,
        other.B * np.array([1e6, 1e-3]),
        other.C / np.array([[1e-6], [1e4]]),
        other.D * np.array([1e6, 1e-3]) / np.array([[1e-6], [1e4]]),
        1.0,
    )
    assert _error(back, plain) < 1e-8


def test_noise_model_is_the_kalman_filter_of_the_truth(oscillators):
    """With process noise the innovations' covariance found equals that of the true Riccati equation."""
    from afdsvc.lti.whitening import innovations

    system, rng = oscillators(7), np.random.default_rng(8)
    n, samples = system.order, 40_000
    u, w = rng.standard_normal((samples, 2)), 0.3 * rng.standard_normal((samples, n))
    y, _ = simulate(
        StateSpace(system.A, np.hstack([system.B, np.eye(n)]), system.C, np.zeros((2, 2 + n)), 1.0), np.hstack([u, w])
    )
    v = np.array([0.5, 1.0])
    measured = y + v * rng.standard_normal(y.shape)
    model = realise(decompose([InputOutputData.of(u, measured, 1.0)], 20, "cva"), n)
    truth = innovations(system, np.diag(v**2), 0.09 * np.eye(n))
    assert np.allclose(model.covariance, truth.covariance, rtol=0.04, atol=0.04 * truth.covariance.max())
    errors = model.errors(u, measured)
    assert np.allclose(errors.T @ errors / samples, model.covariance, rtol=0.02, atol=0.02 * truth.covariance.max())


def test_coloured_noise_biases_neither_instrument(oscillators):
    system, rng = oscillators(9), np.random.default_rng(10)
    u = rng.standard_normal((60_000, 2))
    y, _ = simulate(system, u)
    noise = signal.lfilter([1], [1, -0.95], rng.standard_normal(y.shape), axis=0)
    recording = InputOutputData.of(u, y + 0.2 * y.std(axis=0) * noise / noise.std(axis=0), 1.0)
    assert _error(realise(decompose([recording], 20, "pi-moesp"), 6).system, system) < 0.02
    assert _error(realise(decompose([recording], 20, "po-moesp"), 8).system, system) < 0.02  # two disturbance modes


def test_stable_option_bounds_every_pole_and_leaves_a_stable_estimate_alone(oscillators):
    system = oscillators(11)
    subspace = decompose([_record(system, 12, 400, 3.0)], 8)
    raw, tame = realise(subspace, 12).system, realise(subspace, 12, stable=True).system
    assert np.abs(raw.poles()).max() > 1  # otherwise this test shows nothing
    assert np.abs(tame.poles()).max() < 1
    good = decompose([_record(system, 13, 3000, 0.05)], 8)
    assert np.array_equal(realise(good, 6).system.A, realise(good, 6, stable=True).system.A)


def test_stable_transition_takes_the_smallest_ridge_that_serves():
    rng = np.random.default_rng(14)
    A = np.diag([1.05, 0.5])
    C = rng.standard_normal((1, 2))
    Gamma = np.vstack([C @ np.linalg.matrix_power(A, k) for k in range(8)])
    found = stable_transition(Gamma, 1)
    assert 0.9 < np.abs(np.linalg.eigvals(found)).max() <= 0.9999 + 1e-9


def test_unstable_plant_in_a_stable_loop_is_fitted_through_its_predictor():
    """B and D cannot be found by simulating an unstable model; noise-free data still give the plant back exactly."""
    rng = np.random.default_rng(15)
    system = StateSpace.of([[1.1, 0.2], [0, 0.6]], [[1.0], [0.5]], [[1.0, 0.0]], [[0.0]], 1.0)
    u, y, x = np.zeros((2000, 1)), np.zeros((2000, 1)), np.zeros(2)
    for k in range(2000):
        y[k] = system.C @ x
        u[k] = -0.5 * y[k] + rng.standard_normal()
        x = system.A @ x + system.B @ u[k]
    model = realise(decompose([InputOutputData.of(u, y, 1.0)], 8, "po-moesp"), 2)
    assert np.sort(model.system.poles().real) == pytest.approx([0.6, 1.1], abs=1e-7)
    assert _error(model.system, system) < 1e-6


def test_bad_choices_are_named(oscillators):
    recording = _record(oscillators(1), 1, 2000)
    with pytest.raises(BadInput, match="weighting 'mosep'; expected one of po-moesp, pi-moesp, n4sid, cva"):
        decompose([recording], 10, "mosep")  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="order 40 with horizon 10"):
        realise(decompose([recording], 10), 40)
    with pytest.raises(BadInput, match="horizon 1"):
        decompose([recording], 1)


def test_a_slow_pole_keeps_its_gain():
    """A pole of modulus 0.99998 seen over 20,000 samples: held at 0.9999, four fifths of its gain would be lost."""
    rng = np.random.default_rng(0)
    slow = StateSpace.of([[0.99998]], [[1.0]], [[1.0]], [[0.0]], dt=1.0)
    u = rng.standard_normal((20_000, 1))
    found = realise(decompose([InputOutputData.of(u, simulate(slow, u)[0], 1.0)], 10), 1, stable=True).system
    assert found.poles()[0].real == pytest.approx(0.99998, abs=1e-7)
