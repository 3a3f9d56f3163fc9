"""Peaks of a residual: resonances made up with a known frequency are found, in what repeats and in what does not."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from afdsvc.dataset.experiment import Run
from afdsvc.stats.spectral_peaks import peaks

DT, PERIOD, PERIODS, OMEGA = 1e-3, 2000, 5, 2 * np.pi * 20.0
POLE = np.exp((-0.02 + 1j) * OMEGA * DT)


def run(period: int = PERIOD) -> Run:
    n = PERIOD * PERIODS
    nothing = np.zeros((n, 1))
    return Run("r", DT, 0.0, nothing, nothing, np.zeros((n, 0)), nothing, (), period=period)


def noise(rng: np.random.Generator, n: int = PERIOD * PERIODS) -> np.ndarray:
    return rng.standard_normal((n, 1))


def ringing(drive: np.ndarray) -> np.ndarray:
    """Return the answer of a resonance of damping ratio 0.02, with unit power."""
    answer = lfilter([1.0], np.poly([POLE, POLE.conj()]).real, drive, axis=0)
    return np.asarray(answer / answer.std())


def off(found: list[float]) -> float:
    return min(abs(omega - OMEGA) for omega in found) / OMEGA


def test_a_faint_resonance_in_white_noise_is_the_first_peak():
    """A hundredth of the noise's power."""
    hits = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        hits += off(peaks([run()] * 2, [noise(rng) + 0.1 * ringing(noise(rng)) for _ in range(2)], 2 * np.pi * 250)[:1]) < 0.05
    assert hits >= 18


def test_a_fainter_one_is_found_where_it_repeats_with_the_excitation():
    """Half a hundredth of the noise's power, in what repeats only; without the period it is often lost."""
    hits = lost = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        answer = ringing(np.tile(noise(rng, PERIOD), (PERIODS, 1)))
        left = [noise(rng) + 0.07 * answer for _ in range(2)]
        hits += off(peaks([run()] * 2, left, 2 * np.pi * 250)[:3]) < 0.05
        lost += off(peaks([run(0)] * 2, left, 2 * np.pi * 250)[:3]) > 0.05
    assert hits >= 18
    assert lost >= 5


def test_peaks_stay_within_reach_and_apart():
    rng = np.random.default_rng(3)
    found = peaks([run()], [noise(rng)], 400.0)
    assert 1 <= len(found) <= 5
    assert max(found) <= 400.0
    assert all(abs(a - b) > 0.1 * min(a, b) for k, a in enumerate(found) for b in found[:k])


def test_a_residual_far_above_its_noise_gives_its_largest_peak_too():
    t = DT * np.arange(PERIOD * PERIODS)
    left = 5 * ringing(noise(np.random.default_rng(1))) + 0.3 * np.sin(2 * np.pi * 160 * t)[:, None]
    found = peaks([run(0)], [left], 2 * np.pi * 250)
    assert off(found) < 0.05
    assert min(abs(omega - 2 * np.pi * 160) for omega in found) < 4 * np.pi
