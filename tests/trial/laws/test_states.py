"""Laws with states of their own, and laws that join axes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from afdsvc.trial.laws import states as law

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
