"""Resampling against analytic signals: what is below the cut-off comes through, what is above does not, and nothing is delayed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from afdsvc.files.tables.time_base import FLAT, STOP, reach, resampled


def resample(signal, step: float, dt: float, period: float | None = None, seconds: float = 3.0, phase: float = 0.0) -> np.ndarray:
    """Return (times, values) of a signal sampled every ``step`` and resampled to ``dt``."""
    period = period or max(step, dt)
    t = phase + step * np.arange(round(seconds / step))
    times = np.arange(phase + reach(period), t[-1] - reach(period), dt)
    return times, resampled(signal(t)[:, None], phase, step, times, period)[:, 0]


@settings(max_examples=40, deadline=None)
@given(
    share=st.floats(0.0, FLAT), step=st.sampled_from([1e-3, 0.7e-3, 1.3e-3]), dt=st.floats(0.4e-3, 8e-3),
    phase=st.floats(0, 1e-3), shift=st.floats(0, 6),
)  # fmt: skip
def test_a_sine_below_the_cut_off_is_the_sine_at_the_new_times(share, step, dt, phase, shift):
    omega = 2 * np.pi * share / max(step, dt)

    def sine(t):
        return 5.0 + np.sin(omega * t + shift)

    times, found = resample(sine, step, dt, phase=phase)
    assert np.abs(found - sine(times)).max() < 4e-4


@settings(max_examples=25, deadline=None)
@given(share=st.floats(STOP, 1.0), dt=st.floats(2.5e-3, 8e-3), shift=st.floats(0, 6))
def test_what_would_alias_is_gone(share, dt, shift):
    omega = 2 * np.pi * min(share / dt, 499.0 - 0.5 / dt)
    omega = max(omega, 2 * np.pi * STOP / dt)
    _, found = resample(lambda t: np.sin(omega * t + shift), 1e-3, dt)
    assert np.abs(found).max() < 4e-4


def test_scipys_polyphase_filter_agrees_in_the_pass_band():
    scipy_signal = pytest.importorskip("scipy.signal")
    rng = np.random.default_rng(0)
    t = np.arange(4000) * 1e-3
    lines = rng.uniform(1, 75, 20)
    x = sum(np.sin(2 * np.pi * f * t + p) for f, p in zip(lines, rng.uniform(0, 6, 20), strict=True))
    theirs = scipy_signal.resample_poly(x, 1, 5, window=("kaiser", 8.0))
    times = 5e-3 * np.arange(60, 700)
    ours = resampled(x[:, None], 0.0, 1e-3, times, 5e-3)[:, 0]
    assert np.abs(ours - theirs[60:700]).max() < 0.05 * x.std()  # theirs is not flat up to 80 Hz
    assert np.abs(ours - x[300:3500:5]).max() < 2e-3 * x.std()


def test_a_constant_stays_the_constant_to_rounding():
    _, found = resample(lambda t: np.full(len(t), 1e6), 1e-3, 3.7e-3)
    assert np.abs(found - 1e6).max() < 1e-6


def test_input_and_output_of_a_linear_machine_stay_related():
    """Filtering both by one kernel leaves the relation: x' = -50 x + u, resampled, is what the resampled u makes of it."""
    step, dt = 1e-3, 5e-3
    t = np.arange(8000) * step
    tones = [(3.0, 0.1), (17.0, 1.0), (61.0, 2.0), (170.0, 0.4)]
    u = sum(np.cos(2 * np.pi * f * t + p) for f, p in tones)
    y = sum(np.real(np.exp(1j * (2 * np.pi * f * t + p)) / (2j * np.pi * f + 50)) for f, p in tones)
    times = np.arange(400, 1200) * dt
    both = resampled(np.column_stack([u, y]), 0.0, step, times, dt)
    slow = tones[:3]  # 170 Hz is beyond half of 200 Hz and gone from both
    assert np.abs(both[:, 0] - sum(np.cos(2 * np.pi * f * times + p) for f, p in slow)).max() < 1e-3
    expected = sum(np.real(np.exp(1j * (2 * np.pi * f * times + p)) / (2j * np.pi * f + 50)) for f, p in slow)
    assert np.abs(both[:, 1] - expected).max() < 1e-4
