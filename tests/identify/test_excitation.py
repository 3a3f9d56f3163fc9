"""What the inputs offer is counted, and what they cannot support is refused with a burst to play instead."""

import numpy as np
import pytest

from afdsvc.api.bursts import Burst
from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput
from afdsvc.identify.excitation import excitation, needed_order, require_excitation, supported_order

DT, N = 2e-4, 50_000
T = np.arange(N) * DT


def _record(*inputs):
    u = np.column_stack(inputs)
    return [InputOutputData.of(u, np.zeros((len(u), 1)), DT)]


def _sines(frequencies, seed=0):
    rng = np.random.default_rng(seed)
    return sum(np.sin(2 * np.pi * f * T + rng.uniform(0, 6)) for f in frequencies)


@pytest.mark.parametrize("frequencies", [[62.0], [62.0, 180.0], np.arange(10, 400, 10.0)])
def test_every_line_of_a_multisine_is_counted(frequencies):
    found = excitation(_record(_sines(frequencies)))
    assert found.lines == (len(frequencies),)
    assert found.persistent_order == 2 * len(frequencies)
    assert found.band_hz[0] == pytest.approx((frequencies[0], frequencies[-1]), abs=1.0)


def test_a_line_switched_on_and_off_is_still_one_line():
    for repeats in (1, 3):
        gate = Burst("gate", 1, 8000, 300).envelope()
        u = np.zeros(N)
        for k in range(repeats):
            u[2000 + 15_000 * k :][: len(gate)] = _sines([120.0])[: len(gate)] * gate
        assert excitation(_record(u)).lines == (1,)


def test_lines_of_several_bursts_count_together():
    """Eight recordings of one sine each carry what one recording of eight sines does."""
    sines = [InputOutputData.of(s := _sines([f])[:10_000], s, DT) for f in np.arange(50, 450, 50.0)]
    assert excitation(sines).lines == (8,)
    assert excitation([sines[0], sines[0], sines[1]]).lines == (2,)


def test_supported_order_is_the_inverse_of_the_needed_one():
    for outputs in (1, 2, 3):
        for order in range(1, 20):
            needed = needed_order(order, outputs)
            assert supported_order(needed, outputs) == order
            assert supported_order(needed - 1, outputs) < order


def test_broadband_signals_hold_hundreds_of_lines():
    assert excitation(_record(np.random.default_rng(1).standard_normal(N))).lines[0] > 1000


def test_the_count_is_the_rank_of_the_windows():
    """Oracle: the numerical rank of the matrix of all windows of a sum of k sines is 2 k."""
    for k in (1, 3, 5):
        u = _sines(np.linspace(300, 900, k))[:4000]
        windows = np.lib.stride_tricks.sliding_window_view(u, 20)
        rank = np.linalg.matrix_rank(windows, tol=1e-6 * np.linalg.norm(windows, 2))
        assert excitation([InputOutputData.of(u, u, DT)]).persistent_order == rank == 2 * k


def test_one_sine_cannot_carry_order_six_and_the_refusal_says_what_can():
    with pytest.raises(BadInput) as reported:
        require_excitation(_record(_sines([62.0])), 6, ["valve"], 2, (5.0, 400.0))
    text = str(reported.value)
    assert "input 'valve' holds 1 spectral line: persistent excitation of order 2, expected 10 for a model of order 6" in text
    assert "multisine with at least 20 lines between 5 and 400 Hz" in text
    assert needed_order(6, 2) == 10


def test_a_silent_input_and_inputs_that_move_together_are_named():
    noise = np.random.default_rng(2).standard_normal(N)
    with pytest.raises(BadInput, match="input 'second' never moves"):
        require_excitation(_record(noise, np.full(N, 3.0)), 4, ["first", "second"], 1, (5.0, 400.0))
    for twin in (noise, np.roll(noise, 4)):
        with pytest.raises(BadInput, match="the other inputs explain 100 % of input 'first'"):
            require_excitation(_record(noise, twin), 4, ["first", "second"], 1, (5.0, 400.0))
    free = np.random.default_rng(3).standard_normal(N)
    found = require_excitation(_record(noise, noise + 0.3 * free), 4, ["first", "second"], 1, (5.0, 400.0))
    assert found.dependence[0] == pytest.approx(1 - 0.09 / 1.09, abs=0.01)


def test_a_suggested_burst_passes_the_test_it_was_suggested_by():
    from afdsvc.excite.identification_bursts import Band, multisine_burst

    burst = multisine_burst(Band(5.0, 400.0, np.array([1.0, 1.0]), DT), 2.0, np.random.default_rng(4))
    alpha = burst.play(DT)
    require_excitation([InputOutputData.of(alpha, alpha, DT)], 12, ["first", "second"], 2, (5.0, 400.0))
