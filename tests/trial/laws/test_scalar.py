"""Laws without memory do to a number what physics says."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

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


AT = np.array([0, 1, 2, 3, 0, 1])


def response(function, states: int, omega: float, *p: float) -> complex:
    """Return output over input of a law driven by exp(j omega t), from its settled answer to a sine."""
    row = np.array([*p, 0.0, 0.0, 0.0])

    def rate(t: float, s: np.ndarray) -> np.ndarray:
        ds = np.zeros(states)
        function(np.sin(omega * t), row, s, ds)
        return ds

    return _phasor(function, rate, states, omega, lambda t: (np.sin(omega * t),), row)


def force_response(function, states: int, omega: float, *p: float, both: bool = False) -> complex:
    """Return force over position for a position sin(omega t)."""
    row = np.array([*p, 0.0, 0.0, 0.0])

    def drive(t: float) -> tuple[float, ...]:
        return (np.sin(omega * t), omega * np.cos(omega * t)) if both else (omega * np.cos(omega * t),)

    def rate(t: float, s: np.ndarray) -> np.ndarray:
        ds = np.zeros(states)
        function(*drive(t), row, s, ds)
        return ds

    return _phasor(function, rate, states, omega, drive, row)


def _phasor(function, rate, states: int, omega: float, drive, row: np.ndarray, settle: int = 8) -> complex:
    period = 2 * np.pi / omega
    t = period * (settle + np.arange(100) / 100)
    path = solve_ivp(rate, (0, t[-1]), np.zeros(states), method="LSODA", t_eval=t, rtol=1e-6, atol=1e-9, max_step=period / 8)
    out = np.array([function(*drive(x), row, s, np.zeros(states)) for x, s in zip(t, path.y.T, strict=True)])
    return complex(2 / t.size * np.sum(out * np.exp(-1j * omega * t)) * 1j)


def test_resonance_passes_slow_commands_and_raises_those_at_its_frequency() -> None:
    assert abs(response(law.resonance, 3, 30.0, 1000.0, 0.05)) == pytest.approx(1.0, abs=5e-3)
    assert abs(response(law.resonance, 3, 1030.0, 1000.0, 0.05)) > 4
    assert abs(response(law.resonance, 3, 4000.0, 1000.0, 0.05)) < 0.15


def test_creep_goes_on_for_seconds_and_adds_its_share() -> None:
    s, ds = np.zeros(3), np.zeros(3)
    first = law.creep(1.0, np.array([0.3]), s, ds)
    assert first == 1.0
    s[:] = 1 - np.exp(-1.0 / np.array([0.03, 0.2, 1.4]))
    later = law.creep(1.0, np.array([0.3]), s, ds)
    assert 1.2 < later < 1.3
    assert abs(response(law.creep, 3, 500.0, 0.3)) == pytest.approx(1.0, abs=0.01)


def test_memory_polynomial_multiplies_now_with_before() -> None:
    s, ds = np.array([0.5]), np.zeros(1)
    p = np.array([0.2, 1.0, 0.01])
    assert law.memory_polynomial(2.0, p, s, ds) == pytest.approx(2.0 + 0.2 * 2.0 * (0.5 + 0.25))
    assert law.memory_polynomial(2.0, p, np.zeros(1), ds) == 2.0
    assert ds[0] == pytest.approx(200.0)


def test_flexible_mode_adds_its_mass_when_slow_and_takes_energy_at_its_frequency() -> None:
    p = 0.1, 500.0, 0.02, 1e6
    slow = force_response(law.flexible_mode, 2, 50.0, *p, both=True)
    assert slow.real == pytest.approx(0.1 * 50.0**2 / (1 - 0.01), rel=0.01)  # minus mass times acceleration
    at = force_response(law.flexible_mode, 2, 500.0, *p, both=True)
    assert at.imag < 0  # in phase with -velocity
    assert abs(at) > 10 * 0.1 * 500.0**2


def test_hysteretic_force_dissipates_the_same_at_any_speed() -> None:
    p = 1.0, 0.3, 1.6, 0.5
    losses = [-force_response(law.hysteretic_force, 1, omega, *p).imag for omega in (1.0, 30.0)]
    assert losses[0] > 0.3
    assert losses[0] == pytest.approx(losses[1], rel=1e-3)


@pytest.mark.parametrize("omega", [40.0, 200.0, 1000.0])
def test_fractional_damping_is_half_a_derivative(omega: float) -> None:
    half = -force_response(law.fractional_damping, 8, omega, 1.0)
    assert abs(half) == pytest.approx(np.sqrt(omega), rel=0.06)
    assert np.degrees(np.angle(half)) == pytest.approx(45.0, abs=4.0)


def test_gyroscopic_coupling_couples_velocities_and_turns_with_the_rotor() -> None:
    x, p = np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.5])
    dx, back = np.zeros(4), np.zeros(4)
    law.gyroscopic(AT, p, x, 10.0, dx)
    law.gyroscopic(AT, p, x, -10.0, back)
    assert dx == pytest.approx([0, -0.5 * 10 * 4, 0, 0.9 * 0.5 * 10 * 2])
    assert back == pytest.approx(-dx)


def test_cross_coupled_stiffness_drives_a_forward_whirl_and_vanishes_at_rest() -> None:
    angle = np.linspace(0, 2 * np.pi, 50)
    power = 0.0
    for a in angle:
        x, dx = np.array([np.cos(a), -np.sin(a), np.sin(a), np.cos(a)]), np.zeros(4)
        law.cross_coupled(AT, np.array([3.0, 100.0]), x, 100.0, dx)
        power += dx[1] * x[1] + dx[3] * x[3]
    assert power / angle.size == pytest.approx(3.0)
    dx = np.zeros(4)
    law.cross_coupled(AT, np.array([3.0, 100.0]), np.ones(4), 0.0, dx)
    assert not dx.any()


def test_unbalance_turns_with_the_angle_and_grows_with_the_square_of_speed() -> None:
    dx, fast = np.zeros(4), np.zeros(4)
    law.unbalance(AT, np.array([2.0, 0.5]), 10.0, -0.5, dx)
    assert dx == pytest.approx([0, 200, 0, 0])
    law.unbalance(AT, np.array([2.0, 0.5]), 20.0, -0.5, fast)
    assert fast == pytest.approx(4 * dx)


def test_stiffness_follows_a_signal_about_its_mean() -> None:
    x, p = np.array([1.0, 0.0, 2.0, 0.0]), np.array([0.1, 6.0, 0.5, 100.0, 200.0])
    dx, more = np.zeros(4), np.zeros(4)
    law.stiffness_follows(AT, p, x, 6.0, dx)
    assert not dx.any()
    law.stiffness_follows(AT, p, x, 6.5, more)
    grown = 0.1 * np.expm1(0.4) / 0.4  # a standard deviation up: every further one grows e^0.4 times as much
    assert more == pytest.approx([0, -100.0 * grown, 0, -2.0 * 200.0 * grown])
    twice, little = np.zeros(4), np.zeros(4)
    law.stiffness_follows(AT, p, x, 7.0, twice)
    assert (twice - more)[1] == pytest.approx(np.exp(0.4) * more[1])
    law.stiffness_follows(AT, p, x, 6.0005, little)
    assert little[1] == pytest.approx(-0.1 * 0.001 * 100.0, rel=1e-3)  # p0 per standard deviation, near the mean


def test_parametric_stiffness_swings_between_stiffer_and_softer() -> None:
    p = np.array([0.1, 2 * np.pi, 0.0, 50.0])
    stiffer, softer = np.zeros(4), np.zeros(4)
    law.parametric(AT, p, np.ones(4), 0.25, stiffer)
    law.parametric(AT, p, np.ones(4), 0.75, softer)
    assert stiffer[1] == pytest.approx(-5.0)
    assert softer[1] == pytest.approx(5.0)


def test_bilinear_coupling_needs_both_the_command_and_the_motion() -> None:
    for velocity, command, force in ((2.0, 3.0, 1.2), (0.0, 3.0, 0.0), (2.0, 0.0, 0.0)):
        dx = np.zeros(4)
        law.bilinear(AT, np.array([0.4, 2.0]), np.array([0.0, velocity, 0.0, 0.0]), np.array([command]), dx)
        assert dx[1] == pytest.approx(force)
