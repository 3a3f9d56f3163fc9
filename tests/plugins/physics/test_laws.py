"""Laws of the library on their own, each against something that knows better."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.signal import lsim
from scipy.stats import norm

from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.back_emf import BackEmf
from afdsvc.plugins.physics.backlash import _play
from afdsvc.plugins.physics.clock_offset import read_late
from afdsvc.plugins.physics.cogging import _turning
from afdsvc.plugins.physics.encoder_error import at_angle, by_speed
from afdsvc.plugins.physics.flexible_mode import _attach, bent_spring, masses, mode
from afdsvc.plugins.physics.gain_follows_aux import _scaled
from afdsvc.plugins.physics.hysteresis import bouc_wen, bouc_wen_turned
from afdsvc.plugins.physics.magnetic_force import pair, single
from afdsvc.plugins.physics.parameter_change import _scaled_entries, terms
from afdsvc.plugins.physics.parameter_follows_state import levelling
from afdsvc.plugins.physics.periodic_disturbance import oscillation
from afdsvc.plugins.physics.quantisation import read_in_steps
from afdsvc.plugins.physics.runout import uneven
from afdsvc.plugins.physics.saturation import soft_limit
from afdsvc.plugins.physics.sensor_ac_coupling import SensorAcCoupling
from afdsvc.plugins.physics.sensor_drift import drift
from afdsvc.plugins.physics.sensor_rectification import unsigned
from afdsvc.plugins.physics.slew_limit import _slew
from afdsvc.plugins.physics.static_nonlinearity import power_from
from afdsvc.plugins.physics.stiffness_follows_aux import _spring, springs
from afdsvc.plugins.physics.transport_delay import average, delay
from afdsvc.testing.conformance.physics import machines

DT = 1e-3


def changed(law, parameters, signal, memory: int = 0, dt: float = DT) -> np.ndarray:
    """Return what a law adds, sample by sample."""
    m, added = np.zeros(memory), []
    for z in signal:
        out = np.zeros(1)
        law(np.array(parameters, float), np.atleast_1d(z), m, dt, out)
        added.append(out[0])
    return np.array(added)


def test_a_mass_on_an_axis_moves_as_the_matrices_say():
    """Oracle: scipy simulates the extended plant; the law pulls at the axis within it, step by step."""
    w, zeta, ratio, h = 90.0, 0.03, 0.15, 1e-5
    A = np.array([[0, 1.0], [-4e3, -12.0]])
    plant = StateSpace(A, np.array([[0.0], [1.0]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
    t = np.arange(60000) * h
    u = 1e4 * np.sin(70 * t)
    whole = _attach(plant, (w, zeta, ratio), 1)
    _, y, _ = lsim((whole.A, whole.B, whole.C, whole.D), u, t)
    p, m, x, seen = np.array([w, zeta, ratio]), np.zeros(3), np.zeros(2), []
    for k in range(len(t)):
        seen.append(x[0])
        pull = np.zeros(1)
        masses(p, np.array([x[1] + 0.5 * h * (A @ x)[1] + 0.5 * h * u[k]]), m, h, pull)
        slope = A @ x + np.array([0, u[k] + pull[0]])
        x = x + h * slope + 0.5 * h * h * (A @ slope)
    assert np.abs(np.array(seen) - y).max() < 2e-3 * np.abs(y).max()


def chain(masses_: list[float], springs: list[float], dampers: list[float]) -> np.ndarray:
    """Matrix of masses in a row, states ``v_1, e_1, v_2, e_2, v_3``: e is how far the next mass is ahead."""
    A = np.zeros((2 * len(masses_) - 1,) * 2)
    for k, (stiff, damp) in enumerate(zip(springs, dampers, strict=True)):
        pull = np.zeros(len(A))
        pull[[2 * k, 2 * k + 1, 2 * k + 2]] = -damp, stiff, damp
        A[2 * k] += pull / masses_[k]
        A[2 * k + 2] -= pull / masses_[k + 1]
        A[2 * k + 1, [2 * k, 2 * k + 2]] = -1.0, 1.0
    return A


@pytest.mark.parametrize(("given", "springs"), [([0.3], [800.0]), ([0.3, 0.2], [800.0, 2000.0])])
def test_a_mass_divided_in_a_chain_answers_as_the_chain(given, springs):
    """Oracle: the equations of masses in a row whose sum the model takes for one; in front of the force they are masses side by side
    with the antiresonances for frequencies (Foster's theorem), found by fitting residues."""
    weights, n = [1 - sum(given), *given], len(given)
    A, drive = chain(weights, springs, [0.0] * n), np.eye(2 * n + 1)[:, 0] / weights[0]
    held = A[1:, 1:]  # the first mass held: its frequencies are the antiresonances
    found = np.sort(np.abs(np.linalg.eigvals(held).imag))[:: -2][:n]
    s = 1j * np.geomspace(3, 300, 50)
    answer = np.array([np.linalg.solve(w * np.eye(len(A)) - A, drive)[0] for w in s])
    springing = weights[0] * s - 1 / answer  # minus the force of what hangs on the first mass, per velocity
    columns = np.array([-s * w * w / (s * s + w * w) for w in found]).T
    parts, rest, *_ = np.linalg.lstsq(np.vstack([columns.real, columns.imag]), np.concatenate([springing.real, springing.imag]), rcond=None)
    assert parts.sum() == pytest.approx(sum(given))
    rigid = StateSpace(np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)))
    values = [v for w, part in zip(found, parts, strict=True) for v in (w, 0.0, part / weights[0])]
    whole = _attach(rigid, values, 0, n, divided=True)
    ours = np.array([(whole.C @ np.linalg.solve(w * np.eye(whole.order) - whole.A, whole.B))[0, 0] for w in s])
    assert ours == pytest.approx(answer, rel=1e-6)


def test_a_divided_mass_moves_as_the_matrices_say():
    """The law inside a motor of which only the speed is a state, against scipy on the extended plant."""
    h, values = 1e-4, (60.0, 0.05, 0.8, 150.0, 0.02, 0.3)
    rigid = StateSpace(np.array([[-3.0]]), np.array([[30.0]]), np.ones((1, 1)), np.zeros((1, 1)))
    t = np.arange(10000) * h
    u = np.sin(40 * t) + np.sin(130 * t)
    whole = _attach(rigid, values, 0, 2, divided=True)
    _, y, _ = lsim((whole.A, whole.B, whole.C, whole.D), u, t)
    p, m, v, seen = np.array([*values, -3.0, 30.0]), np.zeros(5), 0.0, []
    for now in u:
        seen.append(v)
        pull, middle = np.zeros(1), v + 0.5 * h * (30 * now - 3 * v)
        masses(p, np.array([middle, middle, now]), m, h, pull)
        slope = -3 * v + 30 * now + pull[0]
        v += h * slope - 0.5 * h * h * 3 * slope
    assert np.abs(np.array(seen) - y).max() < 5e-3 * np.abs(y).max()


def test_a_mass_on_a_bent_spring_is_the_duffing_oscillator_on_a_moving_base():
    """Oracle: scipy's DOP853 on ``s'' = -w^2 d (1 + k d^2) - 2 zeta w d'``, ``d = s - q``; the pull is ``-p2 s''``."""
    w, zeta, ratio, bend, h = 90.0, 0.03, 0.15, 0.4, 1e-4
    t = np.arange(8000) * h
    q, v = np.sin(70 * t), 70 * np.cos(70 * t)

    def slope(now: float, x: np.ndarray) -> list[float]:
        d, rate = x[0] - np.sin(70 * now), x[1] - 70 * np.cos(70 * now)
        return [x[1], -(w**2) * d * (1 + bend * d * d) - 2 * zeta * w * rate]

    true = solve_ivp(slope, (0, t[-1]), [q[0], v[0]], method="DOP853", t_eval=t, rtol=1e-9, atol=1e-9).y
    s2 = np.array([slope(now, x)[1] for now, x in zip(t, true.T, strict=True)])
    assert np.abs(true[0] - q).max() > 1.2  # the spring is stiffer by more than half then
    pulls = changed(bent_spring, [w, zeta, ratio, bend], v, 3, h)
    assert pulls[1:] == pytest.approx(-ratio * (s2[1:] + s2[:-1]) / 2, abs=0.005 * ratio * np.abs(s2).max())
    straight = [changed(law, [w, zeta, ratio, *more], v, 3, h) for law, more in ((masses, ()), (bent_spring, (0.0,)))]
    assert straight[0] == pytest.approx(straight[1], rel=1e-9, abs=1e-9 * np.abs(straight[0]).max())


def test_a_mode_begins_with_its_place_and_its_velocity_over_the_frequency():
    w, zeta, q, v = 40.0, 0.05, 0.7, -0.4
    memory, found = np.array([q, v]), []
    for _ in range(300):
        out = np.zeros(1)
        mode(np.array([w, zeta, 2.0]), np.zeros(1), memory, DT, out)
        found.append(out[0])
    t = DT * np.arange(1, 301)
    wd = w * math.sqrt(1 - zeta**2)
    assert found == pytest.approx(2.0 * np.exp(-zeta * w * t) * (q * np.cos(wd * t) + (v + zeta * q) * w / wd * np.sin(wd * t)), abs=1e-9)


@pytest.mark.parametrize("law", [masses, bent_spring])
def test_a_hung_mass_begins_with_its_deflection_times_the_frequency_and_its_own_velocity(law):
    """On an axis that moves evenly nothing but what it begins with moves it: the pull is the mass' own change of momentum."""
    w, zeta, e, s, ratio, moving = 40.0, 0.05, 0.02, -0.4, 0.3, 1.5
    memory, found = np.array([w * e, s, 0.0]), []
    for _ in range(300):
        out = np.zeros(1)
        law(np.array([w, zeta, ratio, 0.0][: 3 if law is masses else 4]), np.array([moving]), memory, DT, out)
        found.append(out[0] * DT)
    t = DT * np.arange(301)
    wd = w * math.sqrt(1 - zeta**2)
    rate = np.exp(-zeta * w * t) * (s * np.cos(wd * t) - (w * w * e + zeta * w * s) / wd * np.sin(wd * t))
    assert found == pytest.approx(-ratio * np.diff(rate), abs=1e-9 if law is masses else 1e-6)


def test_a_mass_on_an_axis_that_stands_still_does_not_pull():
    assert changed(masses, [90.0, 0.03, 0.2], np.zeros(50), 3) == pytest.approx(np.zeros(50), abs=1e-12)


def test_slow_motion_carries_the_mass_along():
    """Far below its resonance the mass is one with the axis: it pulls back its mass times the acceleration."""
    t = np.arange(4000) * DT
    v, a = 2 * np.cos(2 * t), -4 * np.sin(2 * t)
    pulls = changed(masses, [200.0, 0.7, 0.2], v, 3)
    assert pulls[500:] == pytest.approx(-0.2 * a[500:], abs=0.02)


def test_saturation_is_the_identity_below_its_knee_and_the_limit_beyond():
    u = np.linspace(-3, 3, 601)
    limited = u + changed(soft_limit, [1.5, 0.2], u)
    inside, beyond = np.abs(u) <= 1.2, np.abs(u) >= 1.8
    assert np.array_equal(limited[inside], u[inside])
    assert np.abs(limited[beyond]) == pytest.approx(np.full(beyond.sum(), 1.5))
    assert (np.diff(limited) >= -1e-12).all()
    assert np.abs(np.diff(limited, 2)).max() < 2e-4  # no corner: a hard limit would bend by the step, 0.01


def test_play_without_wear_is_play_and_with_it_the_mean_of_two():
    u = np.concatenate([np.linspace(0, 3, 31), np.linspace(3, -3, 61)])
    narrow, wide = (u + changed(_play, [g, 0.0], u, 2) for g in (0.8, 1.2))
    assert u + changed(_play, [1.0, 0.2], u, 2) == pytest.approx((narrow + wide) / 2)
    assert narrow[30] == pytest.approx(3 - 0.4)
    assert narrow[31:38] == pytest.approx(np.full(7, 2.6))


@pytest.mark.parametrize(("target", "rate"), [(1.0, 400.0), (-1.0, 250.0), (0.1, 400.0)])
def test_slew_limit_gives_the_mean_of_the_ramp_over_the_step(target, rate):
    """Oracle: the ramp, integrated."""
    added = changed(_slew, [400.0, 250.0], [0.0, target, target], 2)

    def ramp(t: float) -> float:
        return math.copysign(min(rate * t, abs(target)), target)

    for k in (1, 2):
        mean = quad(ramp, (k - 1) * DT, k * DT, points=[min(abs(target) / rate, k * DT)])[0] / DT
        assert target + added[k] == pytest.approx(mean)


def test_a_lag_behind_a_delay_answers_a_step_late_and_then_exponentially():
    """Oracle: the step response in closed form, its mean over each step; a whole delay, and one between two samples by linear interpolation."""
    tau, u = 12 * DT, np.repeat([0.0, 1.0], [10, 90])

    def answer(samples):
        begun = np.maximum(np.arange(101) - 10 - samples, 0) * DT
        return np.diff(begun - tau * (1 - np.exp(-begun / tau))) / DT

    for late, expected in ((7, answer(7)), (7.25, 0.75 * answer(7) + 0.25 * answer(8))):
        np.testing.assert_allclose(u + changed(delay, [late * DT, tau], u, 40), expected, atol=1e-12)


@pytest.mark.parametrize("window", [1.0, 2.5, 7.0])  # samples
def test_the_mean_over_a_window_is_that_of_values_held_between_samples(window):
    """Averages of a staircase, seen a quarter of a sample apart; before the recording it stands at its first value."""
    rng = np.random.default_rng(2)
    steps, fine = rng.standard_normal(60), 400
    stairs = np.concatenate([np.full(20 * fine, steps[0]), np.repeat(steps, fine)])
    width = round(window * fine)
    total = np.concatenate([[0.0], np.cumsum(stairs)])
    ends = np.arange(len(stairs) - len(steps) * fine, len(stairs), fine // 4) + fine // 8  # middles of quarter steps
    expected = (total[ends] - total[ends - width]) / width
    found = np.repeat(steps, 4) + changed(average, [window * DT], np.repeat(steps, 4), memory=2 + 50, dt=DT / 4)
    assert found == pytest.approx(expected, abs=1e-9)
    assert found[:4] == pytest.approx(steps[0])
    short, longest = (changed(average, [length * DT], steps, memory=2 + 12) for length in (1e3, 10.0))
    assert short == pytest.approx(longest)  # what the ring holds


@pytest.mark.parametrize("samples", [0.3, 1.0, 2.6, 7.0, 9.0])
def test_a_late_clock_moves_all_inputs_alike(samples):
    """Oracle: linear interpolation by numpy; what is later than the samples at hand stays the last of them."""
    t, u = np.arange(40), np.random.default_rng(3).standard_normal((40, 2))
    held = np.vstack([u, np.repeat(u[-1:], 7, axis=0)])
    z = np.column_stack([held[k : k + 40] for k in range(8)])
    for count, signals in ((2, z), (1, z[:, ::2])):
        m, added = np.zeros(0), np.zeros((40, count))
        for row, out in zip(signals, added, strict=True):
            read_late(np.array([samples * DT]), row, m, DT, out)
        late = np.minimum(t + min(samples, 7.0), 39.0)
        expected = np.column_stack([np.interp(late, t, u[:, j]) for j in range(count)])
        np.testing.assert_allclose(u[:, :count] + added, expected, atol=1e-12)


def test_a_ripple_turns_with_the_shaft():
    """Oracle: the angle in closed form, of a speed that rises in proportion to time; 30 rpm are pi rad/s."""
    periods, unit, amplitude, phase, slope = 12.0, np.pi / 30, 0.4, 0.7, 5e4
    t = DT * np.arange(400)

    def wave(at):
        return amplitude * np.cos(periods * unit * slope * at**2 / 2 + phase)

    begun = np.array([np.cos(phase), np.sin(phase)])
    p, m, q, torque, error = np.array([periods, unit, amplitude]), begun.copy(), np.append(begun, 0.0), [], []
    for at in t:
        out = np.zeros(2)
        _turning(p, np.array([slope * (at + DT / 2)]), m, DT, out[:1])
        by_speed(p, np.array([slope * at]), q, DT, out[1:])
        torque.append(out[0])
        error.append(out[1])
    assert torque == pytest.approx(wave(t + DT / 2), abs=1e-2)
    assert error == pytest.approx(slope * t * wave(t), abs=1e-6)


@pytest.mark.parametrize("law", [single, pair])
def test_a_magnet_is_the_same_in_readings_from_its_operating_point_and_in_absolute_ones(law):
    about = np.random.default_rng(2).uniform(-0.3, 0.3, (20, 2))
    plain = changed(law, [2.0, 1.3, 30.0, -1.0, 0.0, 0.0], about)
    assert changed(law, [2.0, 1.3, 30.0, -1.0, 4.0, 2.6], about + [4.0, 2.6]) == pytest.approx(plain, abs=1e-12)
    assert np.abs(plain).max() > 0.1


def test_an_uneven_encoder_is_read_at_its_angle_and_its_speed_is_the_rate_of_that():
    q, speed = np.linspace(-400, 400, 50), np.linspace(30, 90, 50)

    def error(q):
        return 0.2 * np.cos(3 * np.radians(q)) - 0.1 * np.sin(3 * np.radians(q))

    p = [3.0, np.pi / 180, 0.2, -0.1]
    assert changed(at_angle, p, q) == pytest.approx(error(q))
    for angle, rate in zip(q, speed, strict=True):
        out = np.zeros(2)
        at_angle(np.array(p), np.array([angle, rate]), np.zeros(0), DT, out)
        assert out == pytest.approx([error(angle), (error(angle + 1e-5 * rate) - error(angle - 1e-5 * rate)) / 2e-5], abs=1e-7)


def test_drift_levels_off():
    added = changed(drift, [2.0, 0.25], np.zeros(2001), 1)
    assert added[1] == pytest.approx(2.0 * DT, rel=1e-3)
    assert added[2000] == pytest.approx(2.0 * (2.0 - 0.25 * 4.0))
    assert added[2000] - added[1999] == pytest.approx(0.0, abs=2e-3 * DT)


def test_runout_is_the_first_three_harmonics():
    angle = 2 * np.pi * np.arange(64) / 64
    parts = [0.3, -0.1, 0.2, 0.05, -0.07, 0.4]
    spectrum = np.fft.rfft(changed(uneven, parts, np.column_stack([np.zeros(64), angle]))) / 32
    assert spectrum[1:4] == pytest.approx([complex(parts[2 * k], -parts[2 * k + 1]) for k in range(3)])
    assert np.abs(spectrum[4:]).max() < 1e-12


def test_an_ac_coupled_sensor_is_a_high_pass_by_law_and_matrices():
    """Against scipy's exact answer for inputs that run straight between samples."""
    h = next(iter(SensorAcCoupling().hypotheses(machines()[2])))
    dt, tau, t = 2e-3, 0.05, 2e-3 * np.arange(400)
    y, memory, read = 3.0 + np.sin(20 * t) + 0.5 * t, np.zeros(3), []
    for value in y:
        out = np.zeros(1)
        h.law(np.array([tau, 1.0]), np.array([value]), memory, dt, out)
        read.append(value + out[0])
    _, expected, _ = lsim(([-1 / tau], [1 / tau], [-1.0], [1.0]), y, t, X0=[y[0]])
    assert read == pytest.approx(expected, abs=1e-9)
    assert abs(read[0]) < 1e-12
    plant = h.linear(StateSpace.of([[-3.0]], [[2.0]], [[1.5]], [[0.5]]), [tau])
    s = 7j
    assert plant.C @ np.linalg.solve(s * np.eye(2) - plant.A, plant.B) + plant.D == pytest.approx(np.array([[(3.0 / (s + 3) + 0.5) * s * tau / (s * tau + 1)]]))


def test_a_number_that_follows_a_signal_levels_off():
    number, x = 2.0, np.array([-30.0, -1.0, 0.0, 3.0, 5.0])
    signal = np.column_stack([np.full(5, number), x])
    assert changed(levelling, [-0.5, 3.0], signal) == pytest.approx(number * -0.5 * x**2 / (x**2 + 9.0))


def test_what_follows_a_signal_may_bend():
    signal = np.column_stack([np.full(5, 2.0), 6.0 + np.arange(-2, 3)])
    d = np.arange(-2, 3)
    assert changed(_scaled, [0.1, 6.0, 0.02], signal) == pytest.approx(2.0 * (0.1 * d + 0.02 * d**2))
    assert changed(_spring, [30.0, 6.0, 5.0], signal) == pytest.approx(-2.0 * (30.0 * d + 5.0 * d**2))
    z, out = np.array([2.0, -1.0, 7.5]), np.zeros(2)
    springs(np.array([30.0, 40.0, 6.0, 0.1]), z, np.zeros(0), DT, out)
    assert out == pytest.approx([-30 * 1.15 * 1.5 * 2, 40 * 1.15 * 1.5])


def test_a_loop_that_is_not_turned_is_the_plain_one():
    w = np.concatenate([np.linspace(0, 2, 400), np.linspace(2, -2, 800), np.linspace(-2, 1, 600)])
    plain, turned = (changed(law, p, w, 3) for law, p in ((bouc_wen, [2.0, 0.7, 1.3]), (bouc_wen_turned, [2.0, 0.7, 1.3, 0.0])))
    assert turned == pytest.approx(plain, abs=0.02)


def test_a_turned_loop_is_the_published_one():
    """Oracle: scipy integrates the equation and parameters of the hysteretic benchmark of Noel and Schoukens (2016)."""
    alpha, beta, gamma, delta = 5e4, 1e3, 0.8, -1.1
    t = np.arange(6000) / 6000

    def way(t):  # in m
        return 1.2e-3 * np.sin(2 * np.pi * 3 * t) + 4e-4 * np.sin(2 * np.pi * 11 * t)

    def rate(t):
        return 2 * np.pi * (3 * 1.2e-3 * np.cos(2 * np.pi * 3 * t) + 11 * 4e-4 * np.cos(2 * np.pi * 11 * t))

    exact = solve_ivp(lambda t, z: alpha * rate(t) - beta * (gamma * abs(rate(t)) * z + delta * rate(t) * abs(z)), (0, 1), [0.0], t_eval=t, rtol=1e-9, max_step=1e-4).y[0]
    out, back = gamma + delta, gamma - delta  # dz = alpha dw (1 - out beta / alpha |z|) and dw (1 + back beta / alpha |z|)
    scale = alpha / beta / math.hypot(out, back)
    z = changed(bouc_wen_turned, [scale, scale / alpha, 1.0, math.atan2(back, out)], way(t), 3)
    assert np.abs(z - exact).max() < 2e-3 * np.abs(exact).max()


def test_a_row_of_damping_that_changes_is_the_law_and_the_matrices_alike():
    rows, share = [-30.0, -18.0], -0.4
    speeds = np.random.default_rng(3).standard_normal((20, 2))
    pushes = changed(terms, [share, *rows], speeds)
    A = np.diag([-1.0, -30.0, -2.0, -25.0])
    A[1, 3] = -18.0
    whole = _scaled_entries(StateSpace(A, np.zeros((4, 1)), np.zeros((1, 4)), np.zeros((1, 1))), (share, *rows), 1, np.array([1, 3]))
    assert pushes == pytest.approx(speeds @ (whole.A - A)[1, [1, 3]])
    assert whole.A[1, [1, 3]] == pytest.approx(0.6 * A[1, [1, 3]])
    assert (whole.A != A).sum() == 2


def test_a_sensor_without_a_sign_reads_the_size_and_half_of_that_loses_one_side():
    y = np.linspace(-2, 2, 41)
    assert y + changed(unsigned, [1.0], y) == pytest.approx(np.abs(y))
    assert y + changed(unsigned, [0.5], y) == pytest.approx(np.maximum(y, 0))


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.2, 0.6])
def test_readings_in_steps_are_the_mean_of_rounding_under_noise(noise):
    """Oracle: the mean of the rounded value from the normal distribution's probability of every step."""
    step, origin, x = 0.5, 0.13, np.linspace(-2.0, 2.0, 161) + 1e-4
    added = changed(read_in_steps, (step, origin, noise), x)
    grid = origin + step * np.arange(-12, 13)
    edges = (np.concatenate([grid - step / 2, [grid[-1] + step / 2]])[:, None] - x) / (step * max(noise, 1e-9))
    expected = (grid[:, None] * np.diff(norm.cdf(edges), axis=0)).sum(0) - x
    assert np.abs(added - expected).max() < 1e-3 * step


def test_a_tone_goes_on_as_it_began():
    m, added = np.array([0.3, -0.4]), []
    for _ in range(500):
        out = np.zeros(1)
        oscillation(np.array([40.0, 2.0]), np.zeros(1), m, DT, out)
        added.append(out[0])
    t = DT * np.arange(500)
    assert np.abs(added - 2 * (0.3 * np.cos(40 * t) + 0.4 * np.sin(40 * t))).max() < 1e-9


def test_a_drive_that_starts_at_a_threshold_is_odd_and_meets_the_levels_gain():
    """``(|u| - d)^n`` with its sign: nothing below d, as large as the level where the excess is."""
    u = np.linspace(-10, 10, 401)
    driven = u + changed(power_from, (4.0, 0.5, 2.0), u)
    assert np.abs(driven[np.abs(u) <= 2]).max() == 0.0
    assert np.allclose(driven, -driven[::-1])
    assert np.allclose(driven[u > 2], np.sqrt(4 * (u[u > 2] - 2)))


@pytest.mark.parametrize(("damping", "induced"), [(1.5, 0.0), (1.5 + 1.25 * 0.5, 0.5)])
def test_a_coil_in_matrices_is_the_motor_with_its_current(damping, induced):
    """Inertia 0.2, friction 0.3, torque constant 0.5, 2 ohm, 0.06 H; the model knows no current, and induction as damping or not at all."""
    h = next(iter(BackEmf().hypotheses(machines()[2])))
    found = h.linear(StateSpace.of([[-damping]], [[1.25]], [[1.0]]), [0.03, 0.5, induced])
    motor = StateSpace.of([[-1.5, 2.5], [-0.5 / 0.06, -2 / 0.06]], [[0.0], [1 / 0.06]], [[1.0, 0.0]])
    for s in (0.3j, 5j, 80j):
        given, true = (g.C @ np.linalg.solve(s * np.eye(2) - g.A, g.B) + g.D for g in (found, motor))
        assert given == pytest.approx(true, rel=1e-12)
