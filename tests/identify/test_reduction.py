"""Reductions of G(S): each keeps what it promises, and the ranking is by the loop."""

import numpy as np
import pytest
from scipy.signal import lfilter

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput
from afdsvc.identify.methods.hansen import excited_loop, rebuilt_plant
from afdsvc.identify.reduction import TRUNCATIONS, compare_reductions, noise_whitener, reduction_cost, refine, refine_from
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.python_control import factorise
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import deviation_system
from afdsvc.stats.portmanteau import portmanteau_test

OMEGA = np.geomspace(10, 15_000, 60)


@pytest.fixture(scope="module")
def case(bearing, observer_loop, run_loop, binary):
    """Nominal model with A scaled by 0.7; recordings of the true loop; G(S) of order 18 that equals the true plant."""
    nominal = StateSpace(0.7 * bearing.A, bearing.B, bearing.C, bearing.D, bearing.dt)
    fact, rng = observer_loop(nominal), np.random.default_rng(1)
    d = np.sqrt([0.12, 0.15]) * rng.standard_normal((8000, 2))
    record, alpha, beta = run_loop(fact, bearing, 2 * binary(rng, 8000), d)
    full = rebuilt_plant(fact, deviation_system(fact, bearing))
    return fact, record, InputOutputData.of(alpha, beta, bearing.dt), full


def _error(found, truth):
    a, b = frequency_response(found, OMEGA), frequency_response(truth, OMEGA)
    return np.abs(a - b).max() / np.abs(b).max()


@pytest.mark.parametrize("method", [m for m in TRUNCATIONS if m != "coprime"])
def test_a_plant_that_has_the_wanted_order_comes_back_exactly(case, bearing, method):
    fact, record, _, full = case
    assert full.order == 18
    found = compare_reductions(full, fact, 6, [record], [method])[0]
    assert _error(found.system, bearing) < 1e-6
    assert found.loop_error < 1e-6
    assert found.loop_stable


def test_coprime_reduction_is_exact_at_the_order_of_its_graph(case, bearing):
    """[M + U S; N + V S] has the order of the loop seen from alpha: 12 here."""
    fact, record, _, full = case
    assert _error(compare_reductions(full, fact, 12, [record], ["coprime"])[0].system, bearing) < 1e-6


def test_ranking_is_by_the_error_of_the_loop_and_that_error_is_what_it_says(case):
    fact, record, _, full = case
    found = compare_reductions(full, fact, 4, [record])
    assert [r.loop_error for r in found] == sorted(r.loop_error for r in found)
    best = found[0]
    scale = np.concatenate([record.u.std(axis=0), record.y.std(axis=0)])
    omega = np.linspace(0.002, 0.998, 300) * np.pi / full.dt
    whole, less = (frequency_response(excited_loop(fact, g), omega) for g in (full, best.system))
    weight = record.u.std(axis=0)[None, None, :] / scale[None, :, None]
    wanted = (
        np.linalg.norm((whole - less) * weight, 2, axis=(1, 2)).max()
        / np.linalg.norm(whole * weight, 2, axis=(1, 2)).max()
    )
    assert best.loop_error == pytest.approx(wanted, rel=1e-9)


def test_unstable_plant_keeps_its_unstable_pole_and_its_loop():
    """P4's second-order plant (pole 1.1568) with a fast mode added; the coprime reduction finds order two again."""
    A = np.array([[1.2, -0.05], [1.0, 0.0]])
    plant = StateSpace.of(
        np.block([[A, np.zeros((2, 1))], [np.zeros((1, 2)), np.array([[0.1]])]]),
        [[1.0], [0], [0.01]],
        [[0.3, -0.1, 0.01]],
        [[0.0]],
        1.0,
    )
    gain = StateSpace.gain(np.array([[-1.5]]), 1.0)
    fact = factorise(plant, gain)
    found = {r.method: r for r in compare_reductions(plant, fact, 2)}
    assert found["frequency_weighted"].failure.startswith("the frequency-weighted reduction needs recordings")
    for method in ("balanced", "closed_loop", "coprime"):
        r = found[method]
        assert r.loop_stable, r.failure
        assert np.abs(r.system.poles()).max() == pytest.approx(np.abs(plant.poles()).max(), rel=0.01)
        assert r.loop_error < 0.01


def test_a_reduction_that_loses_the_loop_is_reported_not_hidden(case, bearing):
    fact, record, _, full = case
    wrong_sign = StateSpace(bearing.A, -40 * bearing.B, bearing.C, bearing.D, bearing.dt)
    found = reduction_cost("by hand", wrong_sign, full, fact, [record])
    assert not found.loop_stable
    assert found.loop_error == float("inf")
    assert found.failure == "the controller does not stabilise it"


def test_refined_plant_does_not_depend_on_its_start_and_is_better_than_it(case, bearing):
    fact, _, signals, _ = case
    starts = [StateSpace(0.99 * bearing.A, 0.9 * bearing.B, bearing.C, bearing.D, bearing.dt), bearing]
    found = [refine(fact, [signals], start) for start in starts]
    assert _error(found[0].system, found[1].system) < 1e-3
    assert _error(found[0].system, bearing) < 0.02
    assert found[0].gain < 0.9
    assert 0.99 < found[1].gain <= 1  # the truth itself leaves next to nothing to gain


def test_noise_of_any_colour_is_whitened():
    errors = lfilter([1.0, 0.5], [1.0, -0.9], np.random.default_rng(0).standard_normal((8000, 2)), axis=0)
    assert portmanteau_test(errors[:, :1]) < 1e-6
    white = simulate(noise_whitener([errors], 1.0), errors)[0][100:]
    assert portmanteau_test(white[:, :1]) > 0.01
    assert white.std() == pytest.approx(1.0, rel=0.05)


def test_noise_of_strong_colour_is_whitened_before_the_sweeps(case, bearing, run_loop, binary):
    """Noise with pole 0.98, two recordings: whitened, the mean error is below 0.8 of that of plain squares."""
    fact, _, _, _ = case
    plain, whitened = [], []
    for seed in range(2):
        rng = np.random.default_rng(200 + seed)
        d = lfilter([0.2], [1.0, -0.98], rng.standard_normal((3000, 2)), axis=0)
        _, alpha, beta = run_loop(fact, bearing, 2 * binary(rng, 3000), d)
        signals = [InputOutputData.of(alpha, beta, bearing.dt)]
        plain.append(_error(refine(fact, signals, bearing).system, bearing))
        whitened.append(_error(refine_from(fact, signals, [fact.plant]).system, bearing))
    assert np.mean(whitened) < 0.8 * np.mean(plain)


def test_band_of_the_refined_plant_holds_the_truth(case, bearing, run_loop, binary):
    """6 recordings with coloured residuals: 95 % ellipses hold the truth in 85 to 100 % (few recordings; 60 in a study)."""
    fact, _, _, _ = case
    truth, covered = frequency_response(bearing, OMEGA), []
    for seed in range(6):
        rng = np.random.default_rng(100 + seed)
        d = np.sqrt([0.12, 0.15]) * rng.standard_normal((2500, 2))
        _, alpha, beta = run_loop(fact, bearing, 2 * binary(rng, 2500), d)
        covered.append(refine(fact, [InputOutputData.of(alpha, beta, bearing.dt)], bearing).band(OMEGA).covers(truth).mean())
    assert 0.85 < np.mean(covered) <= 1.0
    assert np.median(covered) > 0.9


def test_unknown_method_and_too_high_an_order_are_named(case):
    fact, record, _, full = case
    with pytest.raises(BadInput, match="reduction method 'modred'"):
        compare_reductions(full, fact, 6, [record], ["modred"])
    with pytest.raises(BadInput, match="order 18 cannot be reduced to order 20"):
        compare_reductions(full, fact, 20, [record])
