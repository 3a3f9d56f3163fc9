"""Bursts found again in recorded excitation."""

import numpy as np
import pytest

from afdsvc.api.bursts import Burst, Line
from afdsvc.excite.recorded_bursts import recorded_bursts

DT = 1e-3


def drawn(seed: int) -> Burst:
    rng = np.random.default_rng(seed)
    inputs = int(rng.integers(1, 4))
    lines = [Line(i, *rng.uniform([20, 0.1, 0], [800, 2.0, 6.28])) for i in range(inputs) for _ in range(rng.integers(1, 3))]
    return Burst("b", inputs, int(rng.integers(1200, 4000)), int(rng.integers(2, 200)), tuple(lines))


@pytest.mark.parametrize("seed", range(5))
def test_sums_of_sines_come_back_from_rounded_numbers(seed):
    burst = drawn(seed)
    rest = np.zeros((700, burst.inputs))
    alpha = np.vstack([rest, burst.play(DT), rest, burst.play(DT), rest])
    found = recorded_bursts(np.vectorize(lambda v: float(f"{v:.6g}"))(alpha), DT, 100, 50)
    assert [(k, b.samples, b.ramp, b.settle) for k, b in found] == [(700, burst.samples, burst.ramp, 50), (1400 + burst.samples, burst.samples, burst.ramp, 50)]
    assert np.abs(found[0][1].play(DT) - burst.play(DT)).max() < 1e-4 * np.abs(burst.play(DT)).max()
    assert sorted(line.omega for line in found[0][1].lines) == pytest.approx(sorted(line.omega for line in burst.lines), abs=1e-3)


def test_any_other_excitation_is_a_waveform():
    noise = np.random.default_rng(0).choice([-1.0, 1.0], (800, 2))
    ((first, burst),) = recorded_bursts(np.vstack([np.zeros((300, 2)), noise, np.zeros((300, 2))]), DT, 100, 50)
    assert (first, burst.lines) == (299, ())
    assert np.array_equal(burst.play(DT)[1:-1], noise)


def test_a_pause_shorter_than_the_loop_settles_is_part_of_the_burst():
    alpha = np.zeros((2000, 1))
    alpha[500:900], alpha[950:1300] = 1.0, -1.0
    assert len(recorded_bursts(alpha, DT, 60, 0)) == 1
    assert len(recorded_bursts(alpha, DT, 40, 0)) == 2


def test_no_excitation_no_burst():
    assert recorded_bursts(np.zeros((100, 2)), DT, 10, 0) == []
