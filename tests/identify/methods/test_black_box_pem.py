"""The black-box prediction-error step: at least as good as its start, at the maximum likelihood, in closed loop too."""

import numpy as np
import pytest

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.identify.methods.black_box_pem import black_box_pem, local_structure
from afdsvc.identify.methods.pbsid import decompose_predictor, realise_predictor
from afdsvc.identify.numerics.innovations_form import InnovationsForm
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.stats.portmanteau import portmanteau_test

OMEGA = np.linspace(0.05, 3.0, 40)


def _feedback_record(system, seed, samples, noise=1.0, pole=0.9, gain=0.05):
    rng, n = np.random.default_rng(seed), system.order
    A = np.block([[system.A - gain * system.B @ system.C, -gain * system.B], [np.zeros((2, n)), pole * np.eye(2)]])
    B = np.block([[system.B, np.zeros((n, 2))], [np.zeros((2, 2)), np.eye(2)]])
    signals = np.hstack([rng.standard_normal((samples, 2)), noise * rng.standard_normal((samples, 2))])
    y, _ = simulate(StateSpace(A, B, np.hstack([system.C, np.eye(2)]), np.zeros((2, 4)), 1.0), signals)
    return InputOutputData.of(signals[:, :2] - gain * y, y, 1.0)


def _error(model, system):
    truth = frequency_response(system, OMEGA)
    return np.median(np.abs(frequency_response(model.system, OMEGA) - truth).max(axis=(1, 2))) / np.abs(truth).max()


def test_improves_on_its_start_in_closed_loop(oscillators):
    ratios = []
    for seed in range(5):
        system = oscillators(40 + seed)
        records = [_feedback_record(system, seed, 3000), _feedback_record(system, 100 + seed, 1500)]
        start = realise_predictor(decompose_predictor(records, 40), 8)
        ratios.append(_error(black_box_pem(start, records), system) / _error(start, system))
    assert np.mean(ratios) < 1.0
    assert max(ratios) < 1.25


def test_a_spoiled_start_comes_back_to_the_same_minimum(oscillators):
    system = oscillators(45)
    records = [_feedback_record(system, 5, 4000)]
    start = realise_predictor(decompose_predictor(records, 40), 8)
    s = start.system
    spoiled = InnovationsForm(StateSpace(0.99 * s.A, 1.1 * s.B, s.C, s.D, s.dt), 0.9 * start.gain, start.covariance)
    found, again = black_box_pem(start, records), black_box_pem(spoiled, records)
    assert np.linalg.det(again.covariance) == pytest.approx(np.linalg.det(found.covariance), rel=1e-4)
    before = start.errors(records[0].u, records[0].y)
    assert np.linalg.det(found.covariance) < np.linalg.det(before.T @ before / len(before))
    errors = found.errors(records[0].u, records[0].y)
    assert np.allclose(errors.T @ errors / len(errors), found.covariance, atol=1e-3)  # the initial state is weighted a little differently
    assert portmanteau_test(errors) > 1e-3


def test_local_coordinates_are_as_many_as_matter_and_all_change_the_response(oscillators):
    system = oscillators(46, 5, 2, 3)
    structure = local_structure(system)
    assert len(structure.parameters) == 5 * (2 + 3)
    slopes = []
    for h in np.diag(structure.scales):
        change = frequency_response(structure.build(h), OMEGA) - frequency_response(system, OMEGA)
        slopes.append(np.concatenate([change.real.ravel(), change.imag.ravel()]))
    values = np.linalg.svd(np.array(slopes), compute_uv=False)
    assert values[-1] > 1e-6 * values[0]
    with_feedthrough = StateSpace(system.A, system.B, system.C, np.array([[1.0, 0], [2.0, 0], [0, 0]]), 1.0)
    assert len(local_structure(with_feedthrough).parameters) == 25 + 3  # a column of D that is zero stays zero
