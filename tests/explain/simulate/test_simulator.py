"""The simulation against scipy's, with and without effects."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

from afdsvc.api.physics import MOST_AHEAD, MOST_SIGNALS
from afdsvc.errors import BadInput
from afdsvc.explain.simulate import kernel
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.explain.simulate.predictor import correction_gain
from afdsvc.explain.simulate.simulator import Simulator
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.back_emf import _coil

AXIS = StateSpace.of([[0, 1], [-30, -0.8]], [[0], [20]], [[1, 0]])


def cubic(p, z, m, dt, out):
    out[0] -= p[0] * z[0] ** 3


def dead_zone(p, z, m, dt, out):
    out[0] -= min(max(z[0], -p[0]), p[0])


def amplified(p, z, m, dt, out):
    out[0] += (p[0] - 1) * z[0]


def square(p, z, m, dt, out):
    out[0] += p[0] * z[0] ** 2


def clock(p, z, m, dt, out):
    out[0] += p[0] * math.sin(p[1] * z[0])


class Pendulum:
    """A pendulum with a motor: angle, speed."""

    @staticmethod
    def f(t, x, u, p):
        q, w = x
        return [w, -p["stiffness"] * math.sin(q) - p["damping"] * w + p["gain"] * u[0]]

    @staticmethod
    def h(t, x, u, p):
        return [x[0]]


PENDULUM = {"stiffness": 30.0, "damping": 0.8, "gain": 20.0}


def reference(rate, x0, U, dt):
    """Integrate ``rate(t, x, u)`` with held inputs, sample by sample, to nearly full precision."""
    states = [np.asarray(x0, dtype=float)]
    for k, u in enumerate(U[:-1]):
        span = (k * dt, (k + 1) * dt)
        states.append(solve_ivp(lambda t, x, u=u: rate(t, x, u), span, states[-1], rtol=1e-10, atol=1e-12).y[:, -1])
    return np.array(states)


def play(model, run, x0, effects=(), theta=None, gain=None, **rest):
    found = nominal(model, run.dt)
    n, p = found.plant.order, found.plant.outputs
    theta = np.zeros(len(found.entries)) if theta is None else theta
    return Simulator(found, np.zeros((n, p)) if gain is None else gain).run(run, theta, np.array(x0, dtype=float), effects, **rest)


def test_linear_plant_is_exact(model, recording, excitation):
    x = reference(lambda t, x, u: AXIS.A @ x + AXIS.B @ u, [0.3, -1.0], excitation, 0.01)
    y = play(model(AXIS), recording(excitation), [0.3, -1.0])
    assert np.abs(y.x - x).max() < 1e-8
    assert np.array_equal(y.y[:, 0], y.x[:, 0])


def test_an_input_that_is_a_cubic_between_samples_is_followed_exactly(model, recording):
    """Between four samples of a cubic there is only the cubic; the first and the last two intervals lack a sample."""
    t = 0.01 * np.arange(60)
    u = np.column_stack([1 + 2 * t - 9 * t**2 + 11 * t**3, t**3 - t])
    plant = StateSpace.of(AXIS.A, [[0, 1], [20, 0]], [[1, 0]])
    found = nominal(model(plant), 0.01)
    y = Simulator(found, np.zeros((2, 1)), ramped=True).run(recording(u), np.zeros(len(found.entries)), np.array([0.3, -1.0]))

    def rate(s, x):
        return plant.A @ x + plant.B @ [1 + 2 * s - 9 * s**2 + 11 * s**3, s**3 - s]

    ends = [solve_ivp(rate, (t[k], t[k + 1]), y.x[k], rtol=1e-11, atol=1e-13).y[:, -1] for k in range(1, 57)]
    assert np.abs(y.x[2:58] - ends).max() < 1e-10


def test_linear_plant_with_three_effects(model, recording, excitation, effect):
    effects = [
        effect(dead_zone, "input", [("u", 0)], [("u", 0)], [0.3]),
        effect(cubic, "force", [("x", 0)], [("x", 1)], [40.0]),
        effect(square, "output", [("y", 0)], [("y", 0)], [0.1]),
    ]
    shaped = excitation - np.clip(excitation, -0.3, 0.3)
    x = reference(lambda t, x, u: AXIS.A @ x + AXIS.B @ u - [0, 40 * x[0] ** 3], [0.0, 0.0], shaped, 0.01)
    expected = x[:, 0] + 0.1 * x[:, 0] ** 2
    error = [np.abs(play(model(AXIS), recording(excitation), [0, 0], e).y[:, 0] - expected).max() for e in (effects, finer(effects))]
    assert error[0] < 3e-3 * np.ptp(expected)
    assert error[1] < error[0] / 10  # second order: four sub-steps


def test_what_acts_within_a_sample_reads_the_states_of_its_substep(model, recording, excitation, effect):
    """A coil whose induced voltage stiffens and damps the axis, against the machine with the coil as a state."""
    tau, e = 0.02, 0.05
    A, B = np.zeros((3, 3)), np.array([[0.0], [0.0], [1 / tau]])
    A[:2, :2], A[:2, 2], A[2] = AXIS.A, AXIS.B[:, 0], [0, -e / tau, -1 / tau]
    Ad, Bd, *_ = cont2discrete((A, B, np.eye(3), np.zeros((3, 1))), 0.01)
    states = [np.zeros(3)]
    for u in excitation[:-1]:
        states.append(Ad @ states[-1] + Bd @ u)
    expected, induced = np.array(states)[:, 0], effect(_coil, "input", [("u", 0), ("x", 1)], [("u", 0)], [tau, e, 0.0], memory=3)
    errors = [
        np.abs(play(model(AXIS), recording(excitation), [0, 0], [replace(induced, hypothesis=replace(induced.hypothesis, substeps=k))]).y[:, 0] - expected).max() for k in (4, 16)
    ]
    assert errors[0] < 2e-3 * np.ptp(expected)
    assert errors[1] < errors[0] / 10  # second order


@pytest.mark.parametrize("direct", [0.0, 0.3])
def test_what_acts_within_a_sample_follows_an_input_that_runs_smoothly(model, recording, effect, direct):
    """A dead zone, then a coil whose induced voltage stiffens and damps the axis, then a gain, against the exact machine."""
    tau, e, gain, zone, found = 0.02, 0.05, 1.5, 0.3, nominal(model(StateSpace(AXIS.A, AXIS.B, AXIS.C, np.full((1, 1), direct))), 0.01)

    def voltage(t):
        return 2.5 + 0.8 * np.sin(9.0 * t) + np.sin(4.0 * t + 1.0)

    def rate(t, x):
        return [*(AXIS.A @ x[:2] + AXIS.B[:, 0] * gain * x[2]), (voltage(t) - zone - e * x[1] - x[2]) / tau]

    t = 0.01 * np.arange(300)
    x = solve_ivp(rate, (0.0, t[-1]), [0.0, 0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-12, max_step=0.01).y
    expected = x[0] + direct * gain * x[2]
    effects = [
        effect(dead_zone, "input", [("u", 0)], [("u", 0)], [zone]),
        effect(_coil, "input", [("u", 0), ("x", 1)], [("u", 0)], [tau, e, 0.0], memory=3),
        effect(amplified, "input", [("u", 0)], [("u", 0)], [gain]),
    ]
    errors = []
    for k in (4, 16):
        fine = [replace(one, hypothesis=replace(one.hypothesis, substeps=k)) for one in effects]
        y = Simulator(found, np.zeros((2, 1)), ramped=True).run(recording(voltage(t)[:, None]), np.zeros(len(found.entries)), np.zeros(2), fine).y[:, 0]
        errors.append(np.abs(y - expected)[1:].max() / np.ptp(expected))  # the coil was without current before the first sample
    assert errors[0] < (2e-2 if direct else 1e-4)  # what reaches the output at once lags by half a sub-step
    assert errors[1] < (errors[0] / 3 if direct else 1e-4)


def finer(effects):
    """The same effects in four sub-steps."""
    return [replace(e, hypothesis=replace(e.hypothesis, substeps=4)) for e in effects]


def test_python_code_matches_scipy(model, recording, excitation):
    def rate(t, x, u):
        return [x[1], -30 * math.sin(x[0]) - 0.8 * x[1] + 20 * u[0]]

    x = reference(rate, [2.0, 0.0], excitation, 0.01)
    y = play(model(code=Pendulum, parameters=PENDULUM), recording(excitation), [2.0, 0.0])
    assert np.abs(y.x - x).max() < 3e-6 * np.abs(x).max()


def test_python_code_with_effects(model, recording, excitation, effect):
    effects = [
        effect(dead_zone, "input", [("u", 0)], [("u", 0)], [0.3]),
        effect(cubic, "force", [("x", 0)], [("x", 1)], [3.0]),
        effect(clock, "force", [("t", 0)], [("x", 1)], [2.0, 5.0]),
        effect(square, "output", [("y", 0)], [("y", 0)], [0.1]),
    ]

    def rate(t, x, u):
        return [x[1], -30 * math.sin(x[0]) - 0.8 * x[1] + 20 * u[0] - 3 * x[0] ** 3 + 2 * math.sin(5 * t)]

    x = reference(rate, [0.0, 0.0], excitation - np.clip(excitation, -0.3, 0.3), 0.01)
    expected = x[:, 0] + 0.1 * x[:, 0] ** 2
    y = play(model(code=Pendulum, parameters=PENDULUM), recording(excitation), [0, 0], finer(effects)).y[:, 0]
    assert np.abs(y - expected).max() < 1e-3 * np.ptp(expected)


def test_linear_code_equals_matrices_with_the_same_effects(model, recording, excitation, effect):
    class Axis:
        @staticmethod
        def f(t, x, u, p):
            return [x[1], -30 * x[0] - 0.8 * x[1] + 20 * u[0]]

        @staticmethod
        def h(t, x, u, p):
            return x[0] + 0.01 * u[0]

    plant = StateSpace.of(AXIS.A, AXIS.B, AXIS.C, [[0.01]])
    effects = finer([effect(dead_zone, "input", [("u", 0)], [("u", 0)], [0.3]), effect(cubic, "force", [("x", 0)], [("x", 1)], [40.0])])
    run = recording(excitation)
    a, b = (play(m, run, [0.1, 0.0], effects) for m in (model(plant), model(code=Axis)))
    assert np.abs(a.y - b.y).max() < 1e-4 * np.ptp(a.y)


def test_output_that_multiplies_state_and_input(model, recording, excitation):
    class Power:
        @staticmethod
        def f(t, x, u, p):
            return [-2.0 * x[0] + u[0]]

        @staticmethod
        def h(t, x, u, p):
            return [x[0] * u[0]]

    y = play(model(code=Power, sizes=(1, 1, 1)), recording(excitation), [1.0])
    assert np.array_equal(y.y[:, 0], y.x[:, 0] * excitation[:, 0])


def test_models_without_inputs(model, recording):
    free = StateSpace.of(AXIS.A, np.zeros((2, 0)), AXIS.C, np.zeros((1, 0)))

    class Swing:
        @staticmethod
        def f(t, x, u, p):
            q, w = x
            return w, -p["stiffness"] * math.sin(q) - p["damping"] * w

        @staticmethod
        def h(t, x, u, p):
            return [x[0]]

    run = recording(np.zeros((400, 0)))
    linear = play(model(free), run, [1.0, 0.0])
    expected = reference(lambda t, x, u: AXIS.A @ x, [1.0, 0.0], run.U, 0.01)
    assert np.abs(linear.x - expected).max() < 1e-8
    assert linear.u.shape == (400, 0)
    swing = play(model(code=Swing, sizes=(2, 0, 1), parameters={"stiffness": 30.0, "damping": 0.8}), run, [1.0, 0.0])
    expected = reference(lambda t, x, u: [x[1], -30 * math.sin(x[0]) - 0.8 * x[1]], [1.0, 0.0], run.U, 0.01)
    assert np.abs(swing.x - expected).max() < 1e-6 * np.abs(expected).max()


def test_discrete_code(model, recording, excitation, effect):
    class Map:
        def f(self, t, x, u, p):
            return [x[1], p.a * x[0] - 0.5 * x[1] ** 3 + u[0]]

        def h(self, t, x, u, p):
            return [x[0]]

    x, expected = np.zeros(2), []
    for u in excitation[:, 0]:
        expected.append(x[0])
        x = np.array([x[1], 0.3 * x[0] - 0.5 * x[1] ** 3 + 0.2 * u + 0.5 * 0.01])
    made = model(code=Map(), sample_time=0.01, parameters={"a": 0.3})
    load = effect(constant, "force", [], [("x", 1)], [0.5])
    assert np.allclose(play(made, recording(0.2 * excitation), [0, 0], [load]).y[:, 0], expected, atol=2e-2)
    exact = play(made, recording(0.2 * excitation), [0, 0]).y[:, 0]
    x, expected = np.zeros(2), []
    for u in excitation[:, 0]:
        expected.append(x[0])
        x = np.array([x[1], 0.3 * x[0] - 0.5 * x[1] ** 3 + 0.2 * u])
    assert np.allclose(exact, expected, atol=1e-12)
    with pytest.raises(BadInput, match=r"step of 0\.01 s and the recording is sampled every 0\.02 s"):
        nominal(made, 0.02)


def constant(p, z, m, dt, out):
    out[0] += p[0]


def test_gain_follows_the_recording_of_an_unstable_plant(model, recording, excitation):
    class Inverted:
        @staticmethod
        def f(t, x, u, p):
            return [x[1], 30 * math.sin(x[0]) - 0.8 * x[1] + 20 * u[0]]

        @staticmethod
        def h(t, x, u, p):
            return [x[0]]

    law = np.array([[-8.0, -1.0]])
    x, y, U = np.array([0.1, 0.0]), [], []
    for k in range(400):
        u = law @ x + 0.02 * excitation[k]
        y.append(x[0])
        U.append(u)
        x = solve_ivp(lambda t, x, u=u: [x[1], 30 * math.sin(x[0]) - 0.8 * x[1] + 20 * u[0]], (0, 0.01), x, rtol=1e-10, atol=1e-12).y[:, -1]
    run = recording(np.array(U), Y=np.array(y)[:, None])
    made = model(code=Inverted)
    gain = correction_gain(nominal(made, 0.01), np.zeros(0), (np.array([1.0, 1.0]), np.std(run.Y, axis=0)), 0.1)
    wrong = [0.11, 0.0]
    simulated, predicted = play(made, run, wrong).y, play(made, run, wrong, gain=gain).y
    assert np.abs(simulated - run.Y)[-100:].max() > 1  # leaves the upright position
    assert np.abs(predicted - run.Y)[-100:].max() < 1e-4
    assert np.array_equal(play(made, run, wrong, gain=gain, free=True).y, simulated)


def test_loop_closed_through_the_controller(model, recording, excitation):
    controller = StateSpace.gain([[-0.5]])
    made = model(AXIS, controller=controller)
    direct = play(made, recording(excitation), [0, 0], closed=False)
    closed = play(made, recording(excitation, W=excitation + 0.5 * direct.y), [0, 0], closed=True)
    assert np.abs(closed.y - direct.y).max() < 1e-9
    with pytest.raises(BadInput, match="loop cannot be closed"):
        play(made, recording(excitation), [0, 0], closed=True)


def test_diverging_code_gives_nan_and_no_exception(model, recording):
    class Burst:
        @staticmethod
        def f(t, x, u, p):
            return [x[0] ** 2]

        @staticmethod
        def h(t, x, u, p):
            return [x[0]]

    y = play(model(code=Burst, sizes=(1, 0, 1)), recording(np.zeros((300, 0))), [1.0]).y[:, 0]
    assert np.isfinite(y[:90]).all()
    assert np.isnan(y[-1])


def test_contact_beyond_the_start_gets_the_substeps_it_needs(model, recording, excitation):
    class Stop:
        @staticmethod
        def f(t, x, u, p):
            over = max(abs(x[0]) - 0.05, 0.0)
            return [x[1], -40000.0 * math.copysign(over, x[0]) - 100.0 * (over > 0) * x[1] + 20 * u[0]]

        @staticmethod
        def h(t, x, u, p):
            return [x[0]]

    y = play(model(code=Stop), recording(excitation), [0.0, 0.0]).y[:, 0]
    assert np.abs(y).max() < 0.08


def test_parameters_move_with_theta(model, recording, excitation):
    made = model(code=Pendulum, parameters=PENDULUM)
    moved = {"stiffness": 36.0, "damping": 0.8, "gain": 16.0}
    run = recording(excitation)
    a = play(made, run, [0, 0], theta=np.array([2.0, 0.0, -2.0]))
    assert np.allclose(a.y, play(model(code=Pendulum, parameters=moved), run, [0, 0]).y, atol=1e-12)


def early(p, z, m, dt, out):
    out[0] += (1 - p[0]) * z[1] + p[0] * z[2] - z[0]


@pytest.mark.parametrize("ramped", [False, True])
@pytest.mark.parametrize("direct", [0.0, 0.3])
def test_an_input_recorded_late_acts_before_all_that_changes_it(model, recording, excitation, effect, direct, ramped):
    """The same as the recording moved by hand, whichever effect was found first; at the end the last sample stays."""
    plant = StateSpace(AXIS.A, AXIS.B, AXIS.C, np.full((1, 1), direct))
    moved = 0.25 * np.vstack([excitation[1:], excitation[-1:]]) + 0.75 * np.vstack([excitation[2:], excitation[-1:], excitation[-1:]])
    offset = effect(early, "input", [("u", 0), ("u", 0, 1), ("u", 0, 2)], [("u", 0)], [0.75])
    zone = effect(dead_zone, "input", [("u", 0)], [("u", 0)], [0.2], substeps=3)
    found = nominal(model(plant), 0.01)
    simulator, rest = Simulator(found, np.zeros((2, 1)), ramped), (np.zeros(len(found.entries)), np.zeros(2))
    expected = simulator.run(recording(moved), *rest, [zone])
    for effects in ([zone, offset], [offset, zone]):
        assert simulator.run(recording(excitation), *rest, effects).y == pytest.approx(expected.y, abs=1e-12)


@pytest.mark.parametrize(("stage", "reads"), [("input", ("u", 0, 8)), ("input", ("u", 0, -1)), ("input", ("x", 0, 1)), ("output", ("u", 0, 1))])
def test_only_the_next_samples_of_inputs_can_be_read_ahead(model, recording, excitation, effect, stage, reads):
    wrong = effect(early, stage, [("u", 0), reads, reads], [("u", 0)], [0.5])
    with pytest.raises(BadInput, match="reads samples to come; expected those of inputs, 7 at most, and stage 'input'"):
        play(model(AXIS), recording(excitation), [0, 0], [wrong])


def test_plugins_may_read_what_the_compiled_loop_holds():
    """The loop keeps its own numbers: numba would not notice that those of another file changed."""
    assert (kernel.MOST_SIGNALS, kernel.AHEAD) == (MOST_SIGNALS, MOST_AHEAD)


def test_a_closed_loop_has_no_input_to_come(model, recording, excitation, effect):
    offset = effect(early, "input", [("u", 0), ("u", 0, 1), ("u", 0, 2)], [("u", 0)], [0.75])
    made, run = model(AXIS, controller=StateSpace.gain([[-0.5]])), recording(excitation, W=excitation)
    assert np.array_equal(play(made, run, [0, 0], [offset], closed=True).y, play(made, run, [0, 0], closed=True).y)


def slow(p, z, m, dt, out):
    m[0] += dt / p[0] * (z[0] - m[0])
    out[0] += m[0]


def test_the_memory_of_an_effect_begins_as_the_excitation_left_it(model, recording, effect):
    """A recording that begins under an excitation that ran before is simulated as if one period of it went before the first sample."""
    u = np.tile(2.0 + np.sin(2 * np.pi * np.arange(300) / 100), 4)[:, None]
    lag, run = [effect(slow, "output", [("u", 0)], [("y", 0)], [0.5], memory=1)], replace(recording(u), period=300)
    gain = model(StateSpace.gain(np.eye(1)))
    rest, warm = (play(gain, replace(run, steady=s), [], lag).y[:, 0] for s in (False, True))
    assert warm[:300] == pytest.approx(rest[300:600], abs=0.05)  # the input before the first sample is not known and counts as zero
    assert np.abs(rest[:300] - rest[300:600]).max() > 1.0
