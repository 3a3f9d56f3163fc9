"""Laws on a held command and on a reading, one by one, as what they are."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.trial.laws import field as f

U = np.linspace(-3, 3, 601)


def through(code: int, u: np.ndarray, *values: float, aux: float = 0.0, h: float = 0.01) -> np.ndarray:
    law, memory = np.zeros((1, f.COLUMNS)), np.zeros((1, f.MEMORY))
    law[0, f.CODE], law[0, f.VALUES : f.VALUES + len(values)] = code, values
    return np.array([f.held(law, memory, 0, x, aux, h) for x in u])


def test_uneven_zone_is_flat_inside_and_shifted_outside() -> None:
    y = through(f.UNEVEN_ZONE, U, 1.0, 0.5, 0.01)
    assert np.abs(y[(U > -0.4) & (U < 0.9)]).max() < 0.01
    assert y[-1] == pytest.approx(2.0, abs=0.01)
    assert y[0] == pytest.approx(-2.5, abs=0.01)


def test_sticky_zone_opens_later_than_it_closes() -> None:
    up, down = np.linspace(0, 2, 2001), np.linspace(2, 0, 2001)
    y = through(f.STICKY_ZONE, np.concatenate([up, down]), 1.0, 0.4, 0.02)
    opened, closed = up[np.argmax(y[:2001] > 0.5)], down[np.flatnonzero(y[2001:] > 0.05)[-1]]
    assert opened == pytest.approx(1.0, abs=0.05)
    assert closed == pytest.approx(0.4, abs=0.08)


def test_limits_are_reached_from_inside() -> None:
    y = through(f.UNEVEN_LIMIT, np.linspace(-50, 50, 501), 1.0, 0.8, 6.0)
    assert (y.min(), y.max()) == pytest.approx((-0.8, 1.0), rel=1e-3)
    assert np.abs(y).max() <= 1.0


def test_curve_grid_and_uneven_gain() -> None:
    assert through(f.POWER_CURVE, np.array([-2.0, 4.0]), 0.5, 1.0) == pytest.approx([-(2**1.5), 8.0])
    assert set(np.round(through(f.GRID, U, 0.5), 12)) == set(np.arange(-6, 7) * 0.5)
    y = through(f.LAME, np.array([-10.0, 10.0]), 0.1, 0.01)
    assert y == pytest.approx([-9.0, 11.0], abs=0.01)


def test_gain_follows_the_auxiliary_signal() -> None:
    assert through(f.FOLLOWS, np.array([2.0]), 0.1, 24.0, 1.2, aux=25.2) == pytest.approx([2.0 * 1.12])
    assert through(f.FOLLOWS, np.array([2.0]), 0.1, 24.0, 1.2, aux=24.0) == pytest.approx([2.0])


def test_plays_enclose_an_area_and_pass_large_motion() -> None:
    turn = 3 * np.sin(np.linspace(0, 6 * np.pi, 6001))
    for code, values in ((f.PLAYS, (1.0, 0.5)), (f.SOFT_PLAY, (0.3, 0.0))):
        y = through(code, turn, *values)
        area = np.trapezoid(y[2001:4001], turn[2001:4001])  # a whole turn
        assert abs(area) > 0.5
        assert y.max() > 2.5


def test_delay_is_a_delay_and_the_slew_limit_limits() -> None:
    u = np.sin(np.arange(300) * 0.1)
    assert through(f.LATE, u, 0.05, h=0.01)[5:] == pytest.approx(u[:-5])
    y = through(f.SOFT_SLEW, np.repeat([0.0, 1.0], 200), 2.0, 0.02, h=0.01)
    assert np.diff(y).max() <= 2.0 * 0.01 + 1e-12
    assert y[-1] == pytest.approx(1.0, abs=1e-3)


def test_reading_in_steps() -> None:
    law = np.zeros((1, f.COLUMNS))
    law[0, [f.CODE, f.VALUES]] = f.COARSE, 0.25
    assert [f.readout(law, 0, y) for y in (0.1, 0.13, -0.4)] == [0.0, 0.25, -0.5]
    assert f.readout(law, 1, 0.1) == 0.1
