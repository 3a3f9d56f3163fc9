"""Recordings of a tone that goes on through: their clocks are set so that it has one phase; mains on an excited line is seen."""

from __future__ import annotations

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.explain.clock import _set
from afdsvc.stats.tones import tones

DT, N = 1e-3, 6000


def run(period: int = 1000) -> Run:
    u = np.tile(np.random.default_rng(3).standard_normal((period, 1)), (N // period, 1))
    return Run("r", DT, 0.0, u, np.zeros((N, 1)), np.zeros((N, 0)), np.zeros((N, 1)), (), period=period)


def hum(hertz: float, phase: float, seed: int, amplitude: float = 1.0) -> np.ndarray:
    t = DT * np.arange(N)
    return (amplitude * np.cos(2 * np.pi * hertz * t + phase) + np.random.default_rng(seed).standard_normal(N))[:, None]


def test_the_clocks_of_all_runs_give_the_tone_one_phase():
    omega = 2 * np.pi * 37.4
    clocks = [_set(run(), hum(37.4, phase, seed, 3.0)[:, 0], omega).clock for seed, phase in enumerate((0.3, 2.0, -2.5))]
    for clock, phase in zip(clocks, (0.3, 2.0, -2.5), strict=True):
        assert abs(np.angle(np.exp(1j * (omega * clock - phase)))) < 0.1


def test_mains_on_a_line_of_the_excitation_is_still_a_tone():
    found = tones([run()], [hum(50.0, 0.3, 1, 0.5)])
    assert [round(t.omega / (2 * np.pi)) for t in found] == [50]


def test_what_repeats_at_every_line_is_no_mains():
    shape = np.tile(np.random.default_rng(5).standard_normal((1000, 1)), (N // 1000, 1))
    assert not tones([run()], [shape + hum(50.0, 0.0, 2, 0.0)])
