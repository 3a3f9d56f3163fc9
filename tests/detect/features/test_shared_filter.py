"""One filter for all regressors: the same psi, the same sums, a cost that does not follow the number of faults."""

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.detect.burst_detector import BurstSamples
from afdsvc.detect.features.regressors import regressors
from afdsvc.detect.features.shared_filter import SharedRegressors, shared
from afdsvc.detect.features.sums import Products
from afdsvc.detect.statistics.regression import regression
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.excite.simulated_burst import played, simulate_burst
from afdsvc.lti.lft import FaultDirection, augment
from afdsvc.testing.machines import bearing_problem, random_problem, unstable_problem
from benchmarks.support.streaming import many_faults


def any_faults(problem, count, seed=0):
    """Faults that enter states and outputs anywhere and feed on anything: parameters, not gains."""
    g, rng = problem.plant, np.random.default_rng(seed)
    ways = [
        FaultDirection(
            f"fault_{k}", 0.1 * rng.normal(size=(g.order, 1)), 0.1 * rng.normal(size=(g.outputs, 1)),
            rng.normal(size=(1, g.order)), rng.normal(size=(1, g.inputs)), np.zeros((1, 1)),
        )
        for k in range(count)
    ]  # fmt: skip
    return replace(problem, augmented=augment(g, ways))


MACHINES = {
    "bearing, its faults": lambda: bearing_problem("lqg"),
    "bearing, 50 mixtures of actuators": lambda: many_faults(bearing_problem("lqg"), 50),
    "bearing, 30 of any kind": lambda: any_faults(bearing_problem("proportional"), 30),
    "unstable, 15 of any kind": lambda: any_faults(unstable_problem(), 15),
    "random 1, 20 of any kind": lambda: any_faults(random_problem(1), 20),
    "random 2, 50 of any kind": lambda: any_faults(random_problem(2), 50),
}


def signals(problem, n, seed):
    rng = np.random.default_rng(seed)
    p, m = problem.plant.outputs, problem.plant.inputs
    return rng.normal(size=(n, p)), np.cumsum(rng.normal(size=(n, p)), axis=0), 1e3 * rng.normal(size=(n, m))


@pytest.mark.parametrize("machine", list(MACHINES))
def test_regressors_and_their_sums_are_those_of_every_fault_by_itself(machine):
    problem = MACHINES[machine]()
    plain, one = regressors(problem), shared(regressors(problem))
    assert isinstance(one, SharedRegressors)
    r, y, u = signals(problem, 1500, 1)
    wanted = plain.step(plain.start(), r, y, u)[1]
    series = one.step(one.start(), r, y, u)[1]
    assert np.abs(series[:, 0] - wanted[:, 0]).max() < 1e-12 * np.abs(wanted[:, 0]).max()
    psi = np.einsum("kpf,tf->tkp", one.theta, series[:, 1:].reshape(len(r), -1))
    size = np.abs(wanted[:, 1:]).max(axis=(0, 2))
    assert (np.abs(psi - wanted[:, 1:]).max(axis=(0, 2)) < 1e-9 * size).all()
    sums = Products.empty(*one.theta.shape[1:]).add(series)
    G, b = np.einsum("tip,tjp->ij", wanted[:, 1:], wanted[:, 1:]), np.einsum("tip,tp->i", wanted[:, 1:], wanted[:, 0])
    length = np.sqrt(np.diag(G))
    assert np.abs((sums.information(one.theta) - G) / np.outer(length, length)).max() < 1e-9
    assert np.abs((sums.score(one.theta) - b) / length).max() < 1e-9 * np.sqrt(np.sum(wanted[:, 0] ** 2))


@pytest.mark.parametrize("make", [many_faults, any_faults])
@pytest.mark.parametrize("machine", [lambda: bearing_problem("lqg"), unstable_problem, lambda: random_problem(3)])
def test_states_and_features_do_not_follow_the_number_of_faults(make, machine):
    few, many, most = (shared(regressors(make(machine(), count))) for count in (20, 50, 200))
    assert few.order == many.order == most.order
    assert few.theta.shape[2] == many.theta.shape[2] == most.theta.shape[2]
    assert few.order <= 3 * few.plant.order * (few.plant.inputs + few.plant.outputs)


def test_few_faults_keep_filters_of_their_own_where_that_is_cheaper():
    filters = regressors(unstable_problem())
    assert shared(filters) is filters


def test_blocks_of_any_size_give_the_same_bits():
    one = shared(regressors(bearing_problem()))
    r, y, u = signals(bearing_problem(), 700, 2)
    whole = one.step(one.start(), r, y, u)[1]
    state, parts, sums = one.start(), [], Products.empty(*one.theta.shape[1:])
    for a in range(0, 700, 31):
        state, part = one.step(state, r[a : a + 31], y[a : a + 31], u[a : a + 31])
        parts.append(part)
        sums = sums.add(part)
    assert np.array_equal(np.concatenate(parts), whole)
    assert np.array_equal(sums.square, Products.empty(*one.theta.shape[1:]).add(whole).square)


@pytest.mark.parametrize("machine", ["bearing, its faults", "bearing, 50 mixtures of actuators"])
def test_the_statistic_of_a_burst_is_that_of_every_fault_by_itself(machine):
    problem = MACHINES[machine]()
    burst = default_burst(bearing_problem("lqg"), bearing_problem("lqg").limits, 0.3, 0.4)
    alpha = played(burst, problem.plant.dt, 1000)
    v = np.random.default_rng(3).normal(size=alpha.shape) @ np.linalg.cholesky(problem.covariance).T
    run = simulate_burst(problem, alpha, v, {problem.fault_names[0]: -0.2})
    block = next(b for b in run.blocks(len(run), burst, 1000) if b.burst is not None)
    found = []
    for filters in (regressors(problem), shared(regressors(problem))):
        series = filters.step(filters.start(), run.r, run.y, run.u)[1][1000:]
        statistic = regression(problem, filters)
        sums, _ = statistic.step(statistic.start(burst, run.dt), BurstSamples(0, run.dt, series, block))
        b, G = statistic.normal_equations(sums)
        found.append((statistic.test(sums, burst)[0], b, np.diag(G)))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)
