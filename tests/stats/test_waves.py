"""Waves along a way are found where a position passes them at changing speed."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.stats.waves import MOST, wave_numbers


def recording(seed: int, number: float, size: float, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a way of 50 units and a residual of two outputs, one with a drift of 30 and a wave, one of noise."""
    rng = np.random.default_rng(seed)
    way = 25 * np.sin(np.cumsum(rng.uniform(0.002, 0.006, 4000)))
    drift = 30 * np.cumsum(rng.standard_normal(4000)) / np.sqrt(4000) * 0.1
    e = size * np.sin(number * way + 0.3) + drift + noise * rng.standard_normal(4000)
    return way, np.column_stack([e, rng.standard_normal(4000)])


@pytest.mark.parametrize("number", [0.7, 3.1416, 9.0])
def test_the_wave_number_is_the_first_in_a_residual_that_drifts(number):
    ways, residuals = zip(*(recording(s, number, 1.0, 0.05) for s in (1, 2)), strict=True)
    first, *others = wave_numbers(ways, residuals)
    assert first == pytest.approx(number, abs=2 * np.pi / 50 / 4)
    assert len(others) < MOST


def test_what_differs_between_samples_of_two_recordings_is_no_change():
    """Recordings that end and begin far apart are not compared across the border."""
    way, e = recording(3, 2.0, 1.0, 0.0)
    moved = wave_numbers([way, way], [e, e + 1e6])
    assert moved == wave_numbers([way, way], [e, e])


@pytest.mark.parametrize("way", [np.zeros(500), np.array([1.0, 1.0]), np.full(50, np.nan), np.ones(1)])
def test_a_position_that_does_not_move_has_none(way):
    assert wave_numbers([way], [np.ones((len(way), 1))]) == []


def test_samples_where_a_simulation_was_lost_are_no_way():
    way, e = recording(3, 2.0, 1.0, 0.05)
    way[2000:2010], way[3000], e[3000:3010] = np.inf, np.nan, np.nan
    assert wave_numbers([way], [e])[0] == pytest.approx(2.0, abs=2 * np.pi / 50 / 4)


def test_waves_that_samples_do_not_resolve_are_not_looked_for():
    way = np.tile([0.0, 1.0, 2.0, 1.0], 200)
    assert all(k <= np.pi / 2 for k in wave_numbers([way], [np.sin(3 * way)[:, None]]))
