"""One even grid out of what loggers write: order, doubles, gaps, jitter and rates, each reported and nothing filled in."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from afdsvc.errors import BadInput
from afdsvc.files.tables.alignment import Group, aligned

DT = 1e-3


def group(t, name: str = "drive", signal: str = "u_x", function=np.sin) -> Group:
    t = np.asarray(t, dtype=float)
    return Group(name, t, {signal: function(2 * np.pi * 11 * t)})


@given(st.integers(60, 500), st.floats(-1e3, 1e3), st.integers(0, 10**6))
def test_even_samples_pass_bit_for_bit_and_nothing_is_reported(n, t0, seed):
    x = np.random.default_rng(seed).standard_normal(n)
    pieces, reported = aligned([Group("table", t0 + DT * np.arange(n), {"u_x": x})], "here")
    assert reported == []
    assert len(pieces) == 1
    assert pieces[0].values[:, 0].tobytes() == x.tobytes()
    assert (pieces[0].start, round(pieces[0].dt, 12)) == (t0, DT)


@settings(max_examples=30, deadline=None)
@given(st.permutations(range(60)), st.lists(st.integers(0, 59), max_size=5))
def test_order_and_doubles_are_put_right_and_counted(order, doubles):
    places = [*order, *doubles]
    t = DT * np.array(places)
    pieces, reported = aligned([Group("bus", t, {"u_x": np.array(places, float)})], "here")
    np.testing.assert_array_equal(pieces[0].values[:, 0], np.arange(60))
    late = sum(b < a for a, b in pairwise(places))
    assert any(f"{late} samples of bus came out of order" in s for s in reported) == (late > 0)
    assert any(f"{len(doubles)} samples of bus have the time stamp of another" in s for s in reported) == bool(doubles)


def test_a_gap_makes_two_pieces_and_nothing_in_between():
    t = DT * np.concatenate([np.arange(100), np.arange(107, 200)])
    pieces, reported = aligned([group(t)], "here")
    assert [len(p.values) for p in pieces] == [100, 93]
    assert pieces[1].start == pytest.approx(0.107)
    assert reported == ["drive has 1 gap longer than 1.5 sample times, 0.008 s in all: they stay gaps that divide the recording"]


def test_pieces_too_short_to_tell_anything_are_left_out_and_counted():
    t = DT * np.concatenate([np.arange(100), [110, 111, 112], np.arange(120, 220)])
    pieces, reported = aligned([group(t)], "here")
    assert [len(p.values) for p in pieces] == [100, 100]
    assert "stretches shorter than 50 samples are left out: 1, with 3 samples in all" in reported
    with pytest.raises(BadInput, match=r"here: the longest stretch without a gap has 30 samples of 0.001 s; expected at least 50"):
        aligned([group(DT * np.arange(30))], "here")


def test_jitter_is_interpolated_and_reported():
    rng = np.random.default_rng(0)
    t = DT * (np.arange(2000) + rng.uniform(-0.2, 0.2, 2000))
    pieces, reported = aligned([group(t, function=np.sin)], "here")
    times = pieces[0].start + pieces[0].dt * np.arange(len(pieces[0].values))
    assert np.abs(pieces[0].values[:, 0] - np.sin(2 * np.pi * 11 * times)).max() < (2 * np.pi * 11 * 1.4 * DT) ** 2 / 8
    assert len(reported) == 1
    assert "miss an even grid of 0.001 s by up to" in reported[0]
    assert "interpolated linearly onto it" in reported[0]


def test_stamps_that_jitter_over_an_even_sampling_are_put_on_the_grid_as_they_are():
    rng = np.random.default_rng(0)
    x = rng.standard_normal(2000)
    t = DT * (np.arange(2000) + rng.uniform(-0.2, 0.2, 2000))
    pieces, reported = aligned([Group("drive", t, {"u_x": x})], "here", regular=True)
    assert pieces[0].values[:, 0].tobytes() == x.tobytes()
    assert pieces[0].dt == DT
    assert "only the time stamps jitter" in reported[0]


def test_two_groups_on_one_grid_are_laid_side_by_side_bit_for_bit():
    a, b = group(DT * np.arange(300)), group(DT * np.arange(40, 400), "encoder", "y_x")
    pieces, reported = aligned([a, b], "here")
    assert reported == []
    assert pieces[0].start == pytest.approx(0.04)
    np.testing.assert_array_equal(pieces[0].values, np.column_stack([a.columns["u_x"][40:], b.columns["y_x"][:260]]))


@settings(max_examples=20, deadline=None)
@given(st.floats(0, DT), st.sampled_from([1e-3, 2e-3, 2.5e-3]), st.sampled_from([None, 4e-3, 5e-3]))
def test_two_rates_meet_at_one_and_both_are_right(phase, other, dt):
    fast, slow = group(DT * np.arange(4000)), group(phase + other * np.arange(round(4 / other)), "encoder", "y_x", np.cos)
    pieces, reported = aligned([fast, slow], "here", dt)
    (piece,) = pieces
    t = piece.start + piece.dt * np.arange(len(piece.values))
    assert piece.dt == pytest.approx(dt or max(DT, other))
    assert np.abs(piece.values[:, 0] - np.sin(2 * np.pi * 11 * t)).max() < 5e-4
    assert np.abs(piece.values[:, 1] - np.cos(2 * np.pi * 11 * t)).max() < 5e-4
    if reported:
        assert "one linear-phase low-pass filter for all columns" in reported[-1]


def test_a_gap_stays_a_gap_when_resampled_and_the_filter_never_reaches_over_it():
    t = DT * np.concatenate([np.arange(2000), np.arange(2500, 5000)])
    pieces, _ = aligned([group(t)], "here", dt=4e-3)
    assert len(pieces) == 2
    assert pieces[0].end < 2.0 - 0.09
    assert pieces[1].start > 2.5 + 0.09
    for p in pieces:
        times = p.start + p.dt * np.arange(len(p.values))
        assert np.abs(p.values[:, 0] - np.sin(2 * np.pi * 11 * times)).max() < 5e-4


def test_what_is_no_number_stays_a_gap_when_resampled():
    g = group(DT * np.arange(4000))
    g.columns["u_x"][2000:2003] = np.nan
    pieces, reported = aligned([g], "here", dt=4e-3)
    assert len(pieces) == 2
    assert all(np.isfinite(p.values).all() for p in pieces)
    assert "3 samples of drive are NaN and stay gaps" in reported


def test_samples_without_a_time_are_dropped_and_counted():
    t = DT * np.arange(100)
    t[7] = np.nan
    _, reported = aligned([Group("drive", np.append(t, np.nan), {"u_x": np.ones(101)})], "here", gap=2.5)
    assert reported == [
        "2 samples of drive have no time stamp and are dropped",
        "1 missing samples of drive were interpolated (each run shorter than a gap of the mapping)",
    ]


def test_nothing_but_gaps_is_refused():
    with pytest.raises(BadInput, match="here: drive has 1 samples"):
        aligned([group([0.5, 0.5])], "here")
    with pytest.raises(BadInput, match="drive holds no numbers"):
        aligned([Group("drive", DT * np.arange(200), {"u_x": np.full(200, np.nan)})], "here", dt=5e-3)


def test_a_slow_column_that_no_model_reads_leaves_the_rate_of_the_others():
    fast, other = group(DT * np.arange(4000)), group(DT * np.arange(4000), "encoder", "y_x", np.cos)
    t = 0.0137 + 0.5 * np.arange(9)
    slow = Group("thermometer", t, {"aux_temperature": 20 + 3 * t})
    pieces, reported = aligned([slow, fast, other], "here")
    (piece,) = pieces
    times = piece.start + DT * np.arange(len(piece.values))
    assert piece.dt == DT
    np.testing.assert_allclose(piece.values[:, 0], 20 + 3 * np.clip(times, t[0], t[-1]), rtol=1e-12)
    np.testing.assert_array_equal(piece.values[:, 1], fast.columns["u_x"])
    assert reported == ["thermometer was sampled every 0.5 s and interpolated linearly to 0.001 s, the first and last value held for as long at most"]


def test_where_the_slowest_signal_leaves_too_little_it_is_named():
    with pytest.raises(BadInput, match=r"has 0 samples of 0.5 s, at the rate of the slowest signal, encoder; expected at least 50"):
        aligned([group(DT * np.arange(4000)), group(0.5 * np.arange(9), "encoder", "y_x")], "here")
