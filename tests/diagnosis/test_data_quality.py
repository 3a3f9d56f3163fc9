"""What may reach the detectors: order, gaps, NaN, frozen sensors, wrong shapes; each named."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from afdsvc.api.signals import Block, Channel
from afdsvc.diagnosis.data_quality import Expectation, IntakeState, judge, longest_still
from afdsvc.errors import BadInput

CHANNELS = (Channel("u_a", "V"), Channel("y_b", "um"))
EXPECTED = Expectation(CHANNELS, 1e-3, frozen_after=20)
RNG = np.random.default_rng(0)


def block(k0: int, seq: int, n: int = 50, session: str = "s", values=None, channels=CHANNELS, dt: float = 1e-3) -> Block:
    values = RNG.standard_normal((n, len(channels))) if values is None else values
    return Block("m", session, seq, k0, dt, 0, channels, values)


def run(blocks):
    state, out = IntakeState(), []
    for b in blocks:
        state, judged = judge(EXPECTED, state, b)
        out.append(judged)
    return out


def test_a_clean_stream_is_usable_after_its_start():
    out = run([block(50 * i, i) for i in range(5)])
    assert [j.usable for j in out] == [True] * 5
    assert [j.gap for j in out] == [True, False, False, False, False]
    assert all(not j.findings for j in out)


def test_missing_samples_are_counted_and_named():
    out = run([block(0, 0), block(200, 4)])
    assert out[1].gap
    assert out[1].lost_samples == 150
    assert "150 samples (3 blocks)" in out[1].findings[0].message


def test_a_late_or_doubled_block_is_left_out_and_the_stream_goes_on():
    out = run([block(0, 0), block(50, 1), block(0, 0), block(100, 2)])
    assert not out[2].usable
    assert "out of order" in out[2].findings[0].message
    assert out[3].usable
    assert not out[3].gap


def test_a_new_session_is_a_new_start_not_a_gap_that_is_reported():
    out = run([block(0, 0), block(0, 0, session="t")])
    assert out[1].gap
    assert not out[1].findings
    assert out[1].lost_samples == 0


def test_nan_names_channel_and_sample():
    values = RNG.standard_normal((50, 2))
    values[7, 1] = np.nan
    out = run([block(0, 0), block(50, 1, values=values), block(100, 2)])
    assert not out[1].usable
    assert "'y_b' is NaN at sample 57" in out[1].findings[0].message
    assert out[2].usable
    assert not out[2].gap


def test_wrong_channels_or_rate_are_named():
    other = (Channel("u_a", "V"), Channel("y_c", "um"))
    out = run([block(0, 0, channels=other), block(0, 0, dt=2e-3)])
    assert "channels u_a, y_c; expected u_a, y_b" in out[0].findings[0].message
    assert "0.002 s; expected 0.001 s" in out[1].findings[0].message


def test_a_wrong_shape_cannot_become_a_block():
    with pytest.raises(BadInput, match=r"block 3 of machine 'm' holds an array of shape \(50, 3\)"):
        block(0, 3, values=np.zeros((50, 3)))


@given(start=st.integers(0, 140), length=st.integers(2, 60), cut=st.integers(5, 60))
def test_a_frozen_sensor_is_found_wherever_blocks_are_cut(start, length, cut):
    y = np.random.default_rng(start).standard_normal((260, 2))
    y[start : start + length, 1] = y[start, 1]
    edges = list(range(0, 260, cut))
    out = run([block(e, i, values=y[e : e + cut]) for i, e in enumerate(edges)])
    reported = [f for j in out for f in j.findings if f.kind == "frozen_sensor"]
    assert bool(reported) == (length - 1 >= 20)
    assert len(reported) <= 1


@given(st.lists(st.booleans(), min_size=1, max_size=40))
def test_longest_still_counts_runs(changes):
    y = np.cumsum(np.array([0, *changes], dtype=float))[:, None]
    best = run_ = 0
    for c in changes:
        run_ = 0 if c else run_ + 1
        best = max(best, run_)
    assert longest_still(y) == best
