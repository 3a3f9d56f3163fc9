"""The misfit from correlations against the misfit from samples."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput
from afdsvc.identify.methods.black_box_pem import local_structure
from afdsvc.identify.numerics.impulse_fit import ImpulseFit, approach, closed_slopes, differences, filtered_slopes
from afdsvc.identify.reduction import refine
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.python_control import factorise
from afdsvc.lti.reduce import balanced_truncation
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import deviation_system, interconnection


@pytest.fixture(scope="module")
def case(bearing, observer_loop, run_loop, binary):
    """Nominal model with A scaled by 0.7, two recordings of alpha and beta, and a start 10 % off in the input gain."""
    fact = observer_loop(StateSpace(0.7 * bearing.A, bearing.B, bearing.C, bearing.D, bearing.dt))
    rng, signals = np.random.default_rng(2), []
    for samples in (3000, 2000):
        d = np.sqrt([0.12, 0.15]) * rng.standard_normal((samples, 2))
        _, alpha, beta = run_loop(fact, bearing, 2 * binary(rng, samples), d)
        signals.append(InputOutputData.of(alpha, beta, bearing.dt))
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


@pytest.mark.parametrize("kind", ["observer", "proportional"])
def test_slopes_are_those_of_the_closed_loop(kind, bearing, observer_loop):
    nominal = StateSpace(0.8 * bearing.A, bearing.B, bearing.C, bearing.D, bearing.dt)
    gain = StateSpace.gain(np.array([[0.2, 0.05], [-0.03, 0.1]]), bearing.dt)
    fact = observer_loop(nominal) if kind == "observer" else factorise(nominal, gain)
    structure, z = local_structure(bearing), np.linspace(-0.01, 0.01, 24)
    steps = np.full(24, 1e-3)
    found = closed_slopes(interconnection(fact), structure.build(z), differences(structure.build, z, steps))
    wanted = differences(lambda v: deviation_system(fact, structure.build(v)), z, steps)
    for name in ("A", "B", "C", "D"):
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), atol=1e-9)


def test_a_feedthrough_is_refused(bearing, observer_loop):
    direct = StateSpace(bearing.A, bearing.B, bearing.C, np.eye(2), bearing.dt)
    moved = differences(local_structure(direct).build, np.zeros(28), np.full(28, 1e-3))
    with pytest.raises(BadInput, match="the plant has a feedthrough"):
        closed_slopes(interconnection(observer_loop(bearing)), direct, moved)


def test_slopes_behind_a_filter(bearing, observer_loop):
    rng = np.random.default_rng(2)
    fact, structure, z, steps = observer_loop(bearing), local_structure(bearing), np.zeros(24), np.full(24, 1e-3)
    after = StateSpace(0.3 * rng.standard_normal((3, 3)), *(rng.standard_normal(s) for s in ((3, 2), (2, 3), (2, 2))), bearing.dt)
    own = closed_slopes(interconnection(fact), structure.build(z), differences(structure.build, z, steps))
    wanted = differences(lambda v: after @ deviation_system(fact, structure.build(v)), z, steps)
    for name in ("A", "B", "C", "D"):
        np.testing.assert_allclose(getattr(filtered_slopes(after, own), name), getattr(wanted, name), atol=1e-9)
