"""The order is chosen on windows left out: it finds the truth, and counts the modes of the disturbance."""

import numpy as np
import pytest
from scipy import signal

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput
from afdsvc.identify.order import choose_order
from afdsvc.lti.simulate import simulate


def _record(system, seed, samples, noise, pole=0.0):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((samples, system.inputs))
    y, _ = simulate(system, u)
    e = signal.lfilter([1], [1, -pole], rng.standard_normal(y.shape), axis=0)
    return [InputOutputData.of(u, y + noise * y.std(axis=0) * e / e.std(axis=0), 1.0)]


@pytest.mark.parametrize("closed_loop", [False, True])
def test_true_order_is_found_in_at_least_nine_of_ten_recordings(oscillators, closed_loop):
    found = [choose_order(_record(oscillators(s), s, 6_000, 0.1), 16, 20, closed_loop).order for s in range(30)]
    assert sum(order == 6 for order in found) >= 24
    assert all(5 <= order <= 8 for order in found)


def test_disturbance_modes_count(oscillators):
    white = choose_order(_record(oscillators(1), 1, 20_000, 0.2), 20, 20).order
    coloured = choose_order(_record(oscillators(1), 1, 20_000, 0.2, pole=0.95), 20, 20).order
    assert (white, coloured) == (6, 8)


def test_nothing_but_white_noise_has_order_zero():
    rng = np.random.default_rng(2)
    record = [InputOutputData.of(rng.standard_normal((8_000, 2)), rng.standard_normal((8_000, 2)), 1.0)]
    assert choose_order(record, 12, 10).order == 0


def test_losses_are_relative_to_order_zero_and_explained(oscillators):
    choice = choose_order(_record(oscillators(3), 3, 5_000, 0.1), 12, 10)
    assert choice.loss[0] == 0
    assert len(choice.loss) == len(choice.standard_error) == 11
    assert choice.sentence.startswith("order 6: the smallest within one standard error")


def test_too_few_windows_are_named(oscillators):
    with pytest.raises(BadInput, match="too few to choose an order"):
        choose_order(_record(oscillators(3), 3, 160, 0.1), 12, 10)
