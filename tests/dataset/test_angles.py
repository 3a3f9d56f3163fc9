"""Angles that are read within one turn."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.angles import turn, unwrapped
from afdsvc.dataset.experiment import prepare
from afdsvc.dataset.sample_checks import samples
from afdsvc.lti.statespace import StateSpace

DRIVE = StateSpace.of([[0, 1], [0, -2.0]], [[0], [20]], [[1, 0]])


def within(angle, one, first):
    """What a sensor of one turn reads that begins at ``first``."""
    return (angle - first) % one + first


@given(st.integers(0, 2**31), st.sampled_from([("deg", 360.0), ("rad", 2 * np.pi), ("turn", 1.0), ("mrad", 2000 * np.pi)]), st.floats(-0.5, 0.5))
def test_the_way_is_found_again_but_for_whole_turns(seed, unit, first):
    rng, one = np.random.default_rng(seed), turn(unit[0])
    assert one == pytest.approx(unit[1])
    way = np.cumsum(rng.uniform(-0.2, 0.24, 400)) * one
    x = within(way, one, first * one)
    x[rng.integers(1, 399, 5)] = np.nan
    found, jumps = unwrapped(x, one)
    gaps = np.abs(np.diff(way[np.isfinite(x)])).max() > 0.25 * one
    if not gaps:
        assert np.nanmax(np.abs(found - way - (found - way)[0])) < 1e-9 * max(1.0, np.abs(way).max())
        assert (jumps > 0) == (np.ptp(np.round((found - x)[np.isfinite(x)] / one)) > 0)
    else:
        assert jumps == 0
        assert np.array_equal(found, x, equal_nan=True)


@pytest.mark.parametrize("x", [
    np.linspace(0, 900, 400),  # goes on beyond a turn
    within(np.arange(400) * 5.0, 720.0, 0.0),  # begins anew after two turns
    np.where(np.arange(400) // 50 % 2, 200.0, 0.0),  # jumps between two places
    np.where(np.arange(400) % 97 == 50, 200.0, 1.0),  # bad samples
    within(np.arange(400) * 100.0, 360.0, 0.0),  # turns so fast that it may turn the other way
    within(np.arange(400) * 5.0, 360.0, 0.0) * 1.5,  # not a turn
])  # fmt: skip
def test_what_may_be_motion_stays(x):
    found, jumps = unwrapped(x, turn("deg"))
    assert jumps == 0
    assert found is x


def test_only_angles_have_a_turn():
    x = within(np.arange(400) * 5.0, 360.0, 0.0)
    assert [turn(u) for u in ("mm", "", "1", "rad/s", "widgets", "N m")] == [0.0] * 6
    assert unwrapped(x, turn("mm"))[1] == 0


@pytest.mark.parametrize("wrapped_reference", [True, False])
def test_a_drive_that_is_read_within_a_turn_is_the_drive_that_turns_and_the_check_says_so(wrapped_reference):
    """The reference is brought to the nearest turn of what it is for."""
    ref = 3000 + 100 * np.arange(600) * 0.01
    y = ref + 3 * np.sin(np.arange(600) / 20) + 4
    read = within(y, 360.0, -180.0)
    columns = np.column_stack([np.zeros(600), read, within(ref, 360.0, -180.0) if wrapped_reference else ref])
    m = Model("drive", (Variable("u", "V"),), (Variable("angle", "deg"),), (Variable("q"), Variable("v", rate_of="q")), DRIVE)
    trace = Trace("r", 0.01, (Channel("u_u", "V"), Channel("y_angle", "deg"), Channel("ref_angle", "deg")), columns)
    (run,) = prepare(m, [trace])
    assert run.wraps == (2,)
    assert np.ptp(run.Y[:, 0] - y) < 1e-9
    assert np.ptp((run.Y - run.REF)[:, 0] - (y - ref)) < 1e-9
    assert np.abs(run.Y - run.REF).max() < 10
    assert any(f.topic == "wraps" and "y_angle is read within one turn; 2 jumps by a turn are taken out" in f.sentence for f in samples(m, [run]))
