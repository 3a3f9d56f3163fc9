"""The misfit from correlations against the misfit from samples."""

import numpy as np
import pytest

from afdsvc.dataset.arrays import Recording
from afdsvc.identify.methods.black_box_pem import local_structure
from afdsvc.identify.numerics.impulse_fit import ImpulseFit, approach
from afdsvc.identify.reduction import refine
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.reduce import balanced_truncation
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace


@pytest.fixture(scope="module")
def case(bearing, observer_loop, run_loop, binary):
    """Nominal model with A scaled by 0.7, two recordings of alpha and beta, and a start 10 % off in the input gain."""
    fact = observer_loop(StateSpace(0.7 * bearing.A, bearing.B, bearing.C, bearing.D, bearing.dt))
    rng, signals = np.random.default_rng(2), []
    for samples in (3000, 2000):
        d = np.sqrt([0.12, 0.15]) * rng.standard_normal((samples, 2))
        _, alpha, beta = run_loop(fact, bearing, 2 * binary(rng, samples), d)
        signals.append(Recording.of(alpha, beta, bearing.dt))
    start = StateSpace(bearing.A, 0.9 * bearing.B, bearing.C, bearing.D, bearing.dt)
    return fact, signals, balanced_truncation(start, 6).system


def test_covariance_is_that_of_the_errors_of_the_cut_off_impulse_response(case):
    fact, signals, start = case
    objective = ImpulseFit(local_structure(start), fact, signals)
    z = np.linspace(-1, 1, 24)
    S = objective.deviation(z)
    markov = np.stack(
        [simulate(S, np.eye(objective.memory + 1, 1) * unit)[0] for unit in np.eye(2)], axis=2
    )  # (L + 1, p, m)
    errors = []
    for r in signals:
        made = [sum(np.convolve(r.u[:, j], markov[:, i, j])[: len(r)] for j in range(2)) for i in range(2)]
        errors.append((r.y - np.column_stack(made))[objective.memory :])
    errors = np.vstack(errors)
    np.testing.assert_allclose(objective.covariance(z), errors.T @ errors / len(errors), rtol=1e-9)


def test_gradient_is_the_slope_of_the_cost(case):
    fact, signals, start = case
    objective = ImpulseFit(local_structure(start), fact, signals)
    objective.weight(np.zeros(24))
    z, step = np.linspace(-1, 1, 24), 1e-3
    slopes = [
        (objective.local(z + h).cost - objective.local(z - h).cost) / (2 * step) for h in np.diag(np.full(24, step))
    ]
    np.testing.assert_allclose(objective.local(z).gradient, slopes, rtol=1e-4, atol=1e-4 * np.abs(slopes).max())


def test_approach_ends_near_the_fit_to_the_samples(case):
    """Windows that reach before a recording are left out, here a ninth of the data: sqrt(1/8) standard errors."""
    fact, signals, start = case
    omega = np.geomspace(10, 15_000, 40)
    near, exact = approach(fact, signals, start), refine(fact, signals, start)
    band = exact.band(omega)
    sd = np.sqrt(band.covariance[..., 0, 0] + band.covariance[..., 1, 1])
    moved = np.abs(frequency_response(near, omega) - band.value) / sd
    first = np.abs(frequency_response(start, omega) - band.value) / sd
    assert np.sqrt(np.mean(moved**2)) < 0.5
    assert np.sqrt(np.mean(first**2)) > 3
