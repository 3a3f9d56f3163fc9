"""Laws that remember: what a sequence becomes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from afdsvc.trial.laws import scalar as law

H = 1e-3


def held(function, u: np.ndarray, *p: float, **named) -> np.ndarray:
    """Run a law of a held command over a sequence, one value per integration step."""
    memory, row = np.zeros(512), np.array([*p, 0.0, 0.0, 0.0])
    out = np.empty_like(u)
    for k, x in enumerate(u):
        out[k] = function(x, row, memory, *named.values(), False)
        assert out[k] == function(x, row, memory, *named.values(), True)  # asking twice does not change the answer
    return out


def test_delay_moves_a_ramp_by_exactly_the_delay() -> None:
    u = np.arange(200) * H
    memory = np.zeros(512)
    out = np.array([law.delayed(x, memory, 7.25, True) for x in u])
    assert np.allclose(out[10:], u[10:] - 7.25 * H, atol=1e-15)


def test_delay_of_nothing_is_the_identity() -> None:
    u = np.sin(np.arange(50.0))
    memory = np.zeros(512)
    assert np.array_equal([law.delayed(x, memory, 0.0, True) for x in u], u)


@pytest.mark.parametrize("tau", [2e-5, 1e-3, 2e-2])
def test_lag_keeps_the_gain_and_delays_by_the_sum_of_its_time_constants(tau: float) -> None:
    step = held(law.lag, np.ones(400), tau, h=H)
    assert step[-1] == pytest.approx(1.0, abs=1e-7)
    assert (np.diff(step) >= -1e-12).all()
    assert np.sum(1.0 - step) * H == pytest.approx(tau * (1 + law.SECOND_POLE), rel=1e-6)


def test_sensor_lag_over_ramps_is_late_by_its_time_constant() -> None:
    memory, tau = np.zeros(8), 5e-3
    y = np.arange(100) * H
    out = np.array([law.ramp_lag(x, tau, memory, 0, H) for x in y[1:]])
    assert out[-1] == pytest.approx(y[-1] - tau, abs=1e-9)


def test_backlash_loses_motion_on_reversal_whatever_the_speed() -> None:
    there_and_back = np.concatenate([np.linspace(0, 3, 31), np.linspace(3, -3, 61)])
    slow = np.concatenate([np.linspace(0, 3, 301), np.linspace(3, -3, 601)])
    y, y_slow = held(law.backlash, there_and_back, 0.5), held(law.backlash, slow, 0.5)
    assert y[30] == pytest.approx(2.5)
    assert y[31:37] == pytest.approx(2.5)  # 0.8 of the play on either side before anything follows
    assert y[-1] == pytest.approx(-2.5)
    assert y[-1] == pytest.approx(y_slow[-1])
    assert y[45] == pytest.approx(y_slow[441], abs=1e-9)


def test_hysteresis_runs_on_a_loop_that_does_not_depend_on_the_rate() -> None:
    p = 0.3, 0.5, 1.6, 0.5

    def loop(points: int) -> float:
        u = np.tile(np.sin(2 * np.pi * np.arange(points) / points), 3)
        y = held(law.hysteresis, u, *p)
        return float(np.sum(y[-points:] * np.gradient(u)[-points:]))

    assert loop(400) < -0.05  # the output lags: y = sin(t - a) against u = sin t gives -pi sin a
    assert loop(400) == pytest.approx(loop(1600), rel=0.02)


def test_hysteresis_of_no_share_is_the_identity() -> None:
    u = np.sin(np.arange(100.0))
    assert np.array_equal(held(law.hysteresis, u, 0.0, 0.5, 1.6, 0.5), u)


def test_slew_limit_bounds_the_rate_and_lets_slow_commands_pass() -> None:
    step = held(law.slew, np.concatenate([np.ones(40), -np.ones(60)]), 50.0, 0.02, h=H)
    assert np.diff(step).max() == pytest.approx(50.0 * H)
    assert np.diff(step).min() == pytest.approx(-0.85 * 50.0 * H)
    assert step[39] == pytest.approx(1.0)
    assert step[-1] == pytest.approx(-1.0)
    slow = 1e-2 * np.sin(np.arange(100) * 0.05)
    late = slow[1:] - 0.4 * np.diff(slow)  # a slow command is followed late, by the corner over the rate
    assert held(law.slew, slow, 50.0, 0.02, h=H)[9:] == pytest.approx(late[8:], abs=4e-5)


@pytest.mark.parametrize(("way", "size"), [(1e-3, 1.0), (3.0, 0.1), (50.0, 0.1), (900.0, 1.0)])
def test_a_servo_follows_its_own_differential_equation(way: float, size: float) -> None:
    """Oracle: scipy integrates ``dw/dt = -size tanh(w / size)``."""
    solved = solve_ivp(lambda t, w: -size * np.tanh(w / size), (0, 2.5), [way], rtol=1e-10, atol=1e-14)
    assert law.servo(way, size, 2.5) == pytest.approx(float(solved.y[0, -1]), rel=1e-7)


def test_stick_slip_pulls_like_a_spring_until_it_lets_go_at_differing_stretches() -> None:
    memory, p = np.zeros(8), np.array([2.0, 0.5, 77.0])
    q = np.linspace(0, 50, 5001)
    force = np.array([law.stick_slip(x, p, memory, True) for x in q])
    assert np.allclose(np.diff(force)[:15], -2.0 * 0.01)
    releases = -force[:-1][np.diff(force) > 0.05]
    assert releases.size > 30
    assert releases.min() > 2 * 0.5 * 0.4 - 1e-9
    assert releases.max() < 2 * 0.5 * 1.6 + 0.03
    assert releases.std() > 0.2
