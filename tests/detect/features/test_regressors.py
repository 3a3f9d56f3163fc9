"""The exact regression identity and the cumulants of noise-driven regressors."""

import numpy as np
import pytest

from afdsvc.detect.features.regressors import regressors, whitener
from afdsvc.detect.thresholds.regressor_information import noise_driven
from afdsvc.errors import BadInput
from afdsvc.excite.simulated_burst import faulty_loop, simulate_burst
from afdsvc.testing.machines import bearing_problem, unstable_problem


def noise(problem, n, seed):
    return np.random.default_rng(seed).normal(size=(n, problem.plant.outputs)) @ np.linalg.cholesky(problem.covariance).T


@pytest.mark.parametrize("controller", ["proportional", "lqg"])
@pytest.mark.parametrize("severity", [-0.1, -1.0])
@pytest.mark.parametrize("fault", range(4))
def test_residual_is_severity_times_regressor_plus_noise(controller, severity, fault):
    problem = bearing_problem(controller)
    filters, name = regressors(problem), problem.fault_names[fault]
    assert filters.exact == (True,) * 4
    v = noise(problem, 800, fault)
    alpha = np.random.default_rng(99).normal(size=(800, 2))
    run = simulate_burst(problem, alpha, v, {name: severity})
    _, series = filters.step(filters.start(), run.r, run.y, run.u)
    left = series[:, 0] - severity * series[:, 1 + fault]
    assert np.abs(left - v @ whitener(problem.covariance).T).max() < 1e-12


def test_regressors_are_first_order_for_an_unstable_plant():
    problem = unstable_problem()
    filters = regressors(problem)
    assert filters.exact == (False, False) or filters.Kp.any()
    alpha = np.random.default_rng(1).normal(size=(600, 1))
    errors = []
    for severity in (-0.02, -0.01):
        run = simulate_burst(problem, alpha, np.zeros((600, 1)), {"b1": severity})
        _, series = filters.step(filters.start(), run.r, run.y, run.u)
        errors.append(np.abs(series[:, 0] - severity * series[:, 1]).max() / abs(severity))
    assert errors[0] < 0.2
    assert errors[1] < 1e-6 or errors[0] / errors[1] == pytest.approx(2.0, rel=0.2)


def test_blocks_of_any_size_give_the_same_bits():
    problem = bearing_problem()
    filters = regressors(problem)
    run = simulate_burst(problem, np.zeros((700, 2)), noise(problem, 700, 3))
    _, whole = filters.step(filters.start(), run.r, run.y, run.u)
    state, parts = filters.start(), []
    for a in range(0, 700, 31):
        state, part = filters.step(state, run.r[a : a + 31], run.y[a : a + 31], run.u[a : a + 31])
        parts.append(part)
    assert np.array_equal(np.concatenate(parts), whole)


# Information per sample that the loop's own noise brings (Fisher information computed independently, frequency domain).
@pytest.mark.parametrize(
    ("controller", "passive"),
    [("proportional", (0.0571643, 0.0631591, 0.0573742, 0.0629056)), ("lqg", (0.798648, 1.001248, 0.802360, 0.998000))],
)
def test_passive_information(controller, passive):
    assert noise_driven(bearing_problem(controller)).passive == pytest.approx(passive, rel=1e-4)


def test_signed_root_is_standard_normal_after_correction():
    problem = bearing_problem("lqg")
    filters, cumulants = regressors(problem), noise_driven(problem)
    n, runs = 500, 4000
    v = noise(problem, n * runs + 2000, 21)
    run = simulate_burst(problem, np.zeros_like(v), v, loop=faulty_loop(problem, {}))
    _, series = filters.step(filters.start(), run.r, run.y, run.u)
    series = series[2000:].reshape(runs, n, 5, 2)
    b = np.einsum("rtfp,rtp->rf", series[:, :, 1:], series[:, :, 0])
    G = np.einsum("rtfp,rtfp->rf", series[:, :, 1:], series[:, :, 1:])
    mean, sd = cumulants.signed_root(n)
    t = -b / np.sqrt(G)
    assert (t.mean(axis=0) > 0.15).all()  # uncorrected it is not centred: the alarm rate would not be kept
    rates = np.mean((t - mean) / sd > 1.645, axis=0)
    assert rates == pytest.approx(0.05, abs=2.58 * np.sqrt(0.05 / runs) + 0.003)


@pytest.mark.parametrize("wrong", [np.array([[1.0, 0.2], [0.3, 1.0]]), -np.eye(2), np.full((2, 2), np.nan)])
def test_a_covariance_that_is_none_is_refused(wrong):
    with pytest.raises(BadInput, match="positive definite"):
        whitener(wrong)
