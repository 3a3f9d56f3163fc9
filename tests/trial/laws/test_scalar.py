"""Laws without memory do to a number what physics says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from afdsvc.trial.laws import scalar as law

X = np.linspace(-4.0, 4.0, 161)


def values(function, *p: float) -> np.ndarray:
    row = np.array([*p, 0.0, 0.0, 0.0, 0.0])
    return np.array([function(x, row) for x in X])


def is_odd(y: np.ndarray) -> bool:
    return bool(np.allclose(y, -y[::-1], atol=1e-12))


def test_dead_zone_swallows_small_commands_and_passes_the_slope_of_large_ones() -> None:
    y = values(law.dead_zone, 1.0, 0.1)
    assert is_odd(y)
    assert np.abs(y[np.abs(X) < 0.5]).max() < 0.01
    assert y[-1] == pytest.approx(3.0, abs=1e-6)
    assert np.gradient(y, X)[-5] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("sharpness", [6.0, 12.0])
def test_saturation_passes_small_commands_and_never_exceeds_its_limit(sharpness: float) -> None:
    y = values(law.saturation, 1.0, sharpness)
    assert is_odd(y)
    assert np.abs(y).max() < 1.0
    assert y[-1] > 0.99
    small = np.abs(X) < 0.4
    assert np.allclose(y[small], X[small], rtol=1e-3)


def test_exponential_gain_has_unit_slope_at_zero_and_grows_with_the_command() -> None:
    y = values(law.exponential, 0.1, 1.0)
    slope = np.gradient(y, X)
    assert slope[80] == pytest.approx(1.0, abs=1e-3)
    assert (np.diff(slope[1:-1]) > 0).all()
    assert y[-1] + y[0] > 1.0  # the even part that tells it from a saturation


def test_gain_law_is_proportional_to_the_command_and_follows_the_signal() -> None:
    p = np.array([0.1, 6.0, 0.5])
    assert law.gain_law(2.0, p, 6.0) == pytest.approx(2.0)
    assert law.gain_law(2.0, p, 6.5) > law.gain_law(2.0, p, 6.0) > law.gain_law(2.0, p, 5.5)
    assert law.gain_law(4.0, p, 6.5) == pytest.approx(2 * law.gain_law(2.0, p, 6.5))


def test_hum_is_a_tone_with_a_weak_third_harmonic() -> None:
    t = np.arange(1000) / 1000.0
    p = np.array([2.0, 2 * np.pi * 50, 0.3])
    spectrum = np.abs(np.fft.rfft([law.hum(p, x) for x in t])) / 500
    assert spectrum[50] == pytest.approx(2.0, rel=1e-6)
    assert spectrum[150] == pytest.approx(0.3, rel=1e-6)
    assert np.delete(spectrum, [50, 150]).max() < 1e-9


@pytest.mark.parametrize(
    ("function", "p"),
    [(law.coulomb, (1.0, 0.05)), (law.stribeck, (1.0, 0.05, 2.5, 0.6)), (law.quadratic_damping, (0.3, 0.1))],
)
def test_friction_and_drag_take_energy_at_every_velocity(function, p) -> None:
    force = values(function, *p)
    assert is_odd(force)
    assert (force * X <= 0).all()
    assert (force * X).min() < 0


def test_coulomb_friction_hardly_depends_on_speed_once_moving() -> None:
    force = values(law.coulomb, 1.0, 0.05)
    assert force[-1] == pytest.approx(-1.0, rel=0.02)
    assert force[-1] == pytest.approx(force[120], rel=0.03)  # 4 against 2


def test_stribeck_friction_falls_from_its_value_at_rest_to_that_of_coulomb() -> None:
    p = np.array([1.0, 0.01, 2.5, 0.6])
    assert law.stribeck(0.15, p) < -2.2
    assert law.stribeck(6.0, p) == pytest.approx(law.coulomb(6.0, p), rel=0.02)


def test_drag_grows_fourfold_with_twice_the_velocity() -> None:
    p = np.array([0.3, 0.01])
    assert law.quadratic_damping(2.0, p) == pytest.approx(4 * law.quadratic_damping(1.0, p), rel=1e-3)


def test_cubic_stiffness_hardens_with_an_exponent_between_three_and_five() -> None:
    force = values(law.cubic, 0.2, 3.0)
    assert is_odd(force)
    assert (force[X > 0] < 0).all()
    p = np.array([0.2, 3.0])
    exponent = math.log2(law.cubic(3.0, p) / law.cubic(1.5, p))
    assert 3.05 < exponent < 5.0


def test_quadratic_stiffness_pulls_to_the_same_side_on_both_sides() -> None:
    p = np.array([0.2, 5.0])
    assert law.quadratic(1.0, p) < 0
    assert law.quadratic(-1.0, p) < 0
    assert law.quadratic(1.0, p) + law.quadratic(-1.0, p) == pytest.approx(-0.4)


def test_contact_is_absent_inside_the_clearance_and_pushes_back_beyond_it() -> None:
    force = values(law.contact, 5.0, 2.0, 0.05)
    assert is_odd(force)
    assert np.abs(force[np.abs(X) < 1.5]).max() < 1e-4
    assert force[-1] == pytest.approx(-5.0 * 2.0**1.5, rel=1e-3)


def test_tempered_square_is_even_distortion() -> None:
    y = values(law.tempered_square, 0.1, 2.0)
    assert np.allclose((y - X), (y - X)[::-1])
    assert (y - X)[-1] == pytest.approx(0.1 * 16 / 2.8)


def test_rectification_has_two_slopes() -> None:
    slope = np.gradient(values(law.rectified, 0.1, 0.05), X)
    assert slope[150] == pytest.approx(1.1, abs=1e-3)
    assert slope[10] == pytest.approx(0.9, abs=1e-3)


def test_quantised_readings_lie_on_the_grid_nearest() -> None:
    y = values(law.quantised, 0.3, 0.1)
    steps = (y - 0.1) / 0.3
    assert np.allclose(steps, np.round(steps), atol=1e-9)
    assert np.abs(y - X).max() <= 0.15 + 1e-12


def test_softplus_does_not_overflow() -> None:
    assert law.softplus(1e4) == 1e4
    assert law.softplus(-1e4) == 0.0
    assert law.softplus(0.0) == pytest.approx(math.log(2.0))
