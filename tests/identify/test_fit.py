"""The bands hold the truth as often as they say."""

import numpy as np
import pytest

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput
from afdsvc.identify.fit import ResponseBand, jackknife_band, repetitions, without_group
from afdsvc.identify.methods.subspace import decompose, realise
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace

OMEGA = np.linspace(0.05, 3.0, 12)


def _estimate(recordings):
    return realise(decompose(recordings, 12), 4).system


def test_band_of_a_subspace_estimate_covers(oscillators):
    """40 recordings, 12 frequencies, 4 entries: joint 95 % ellipses hold the truth in 93 to 98 %."""
    system, rng = oscillators(31, 4), np.random.default_rng(7)
    truth, covered = frequency_response(system, OMEGA), []
    for _ in range(40):
        u = rng.standard_normal((3000, 2))
        y = simulate(system, u)[0]
        record = [InputOutputData.of(u, y + 0.2 * y.std(axis=0) * rng.standard_normal(y.shape), 1.0)]
        covered.append(jackknife_band(_estimate(record), repetitions(_estimate, record, 16), OMEGA).covers(truth))
    assert 0.93 < np.mean(covered) < 0.98


def test_gain_of_a_static_system_has_the_textbook_standard_error():
    """One gain: the jackknife must agree with sigma / sqrt(sum u^2), averaged over recordings, within 10 %."""
    rng, ratios = np.random.default_rng(8), []

    def gain(recordings):
        u, y = (np.vstack([getattr(r, side) for r in recordings]) for side in "uy")
        return StateSpace.gain((u.T @ y) / (u.T @ u), 1.0)

    for _ in range(60):
        u = rng.standard_normal((500, 1))
        record = [InputOutputData.of(u, 2 * u + 0.5 * rng.standard_normal((500, 1)), 1.0)]
        band = jackknife_band(gain(record), repetitions(gain, record, 20), np.array([1.0]))
        ratios.append(band.covariance[0, 0, 0, 0, 0] / (0.25 / (u**2).sum()))
    assert 0.9 < np.mean(ratios) < 1.1


def test_groups_are_stretches_of_the_concatenation():
    records = [
        InputOutputData.of(np.arange(7.0), np.arange(7.0), 1.0),
        InputOutputData.of(7 + np.arange(3.0), 7 + np.arange(3.0), 1.0),
    ]
    kept = [np.concatenate([r.u[:, 0] for r in without_group(records, g, 5)]).tolist() for g in range(5)]
    assert kept[0] == [2, 3, 4, 5, 6, 7, 8, 9]
    assert kept[3] == [0, 1, 2, 3, 4, 5, 8, 9]
    assert kept[4] == [0, 1, 2, 3, 4, 5, 6, 7]


def test_magnitude_band_is_the_projection_on_the_phase():
    value = np.array([[[3 + 4j]]])
    covariance = np.array([[[[[0.25, 0.0], [0.0, 0.04]]]]])
    low, high = ResponseBand(np.array([1.0]), value, covariance).magnitude_band()
    sd = np.sqrt(0.36 * 0.25 + 0.64 * 0.04)
    assert (low.item(), high.item()) == (pytest.approx(5 - 1.959964 * sd), pytest.approx(5 + 1.959964 * sd))


def test_too_few_groups_and_failing_repetitions_are_named(oscillators):
    rng = np.random.default_rng(9)
    record = [InputOutputData.of(rng.standard_normal((100, 2)), rng.standard_normal((100, 2)), 1.0)]
    with pytest.raises(BadInput, match="2 groups"):
        jackknife_band(oscillators(1, 4), repetitions(_estimate, record, 2), OMEGA)
    with pytest.raises(BadInput, match="3 of 3 repetitions of the fit failed"):
        jackknife_band(oscillators(1, 4), repetitions(_estimate, record, 3), OMEGA)
