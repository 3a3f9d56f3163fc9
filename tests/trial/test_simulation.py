"""With nothing hidden the recordings are those of a linear closed loop, simulated here by other means."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from afdsvc.trial import NOTHING, Options, generate_trial, simulation
from afdsvc.trial.machine import TrialMachine
from afdsvc.trial.simulation import play_run, replay


def sampled(machine: TrialMachine, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    A, B, C = machine.matrices(theta)
    n, m = B.shape
    both = expm(machine.dt * np.block([[A, B], [np.zeros((m, n + m))]]))
    return both[:n, :n], both[:n, n:], C


def loop_of_matrices(trial, i: int) -> tuple[np.ndarray, np.ndarray]:
    """Close the sampled plant and the controller in one recursion on stacked states."""
    machine, run, K = trial.machine, trial.runs[i], trial.machine.loop
    Ad, Bd, C = sampled(machine, trial.truth.theta)
    x, xk = np.zeros(Ad.shape[0]), np.zeros(K.order)
    y, u = np.empty_like(run.noise), np.empty_like(run.alpha)
    for k in range(len(y)):
        y[k] = C @ x + run.noise[k]
        entry = np.concatenate([y[k] - run.ref[k], run.alpha[k]])
        u[k] = K.C @ xk + K.D @ entry
        x, xk = Ad @ x + Bd @ u[k], K.A @ xk + K.B @ entry
    return y[run.skip :], u[run.skip :]


CASES = [
    Options(controller="lqg", injection="youla", periods=1),
    Options(controller="lqg", injection="added", periods=1),
    Options(controller="proportional", periods=1),
    Options(machine="positioning_axis", periods=1),
]


@pytest.mark.parametrize("options", CASES, ids=lambda o: f"{o.machine}-{o.controller}-{o.injection}")
def test_nothing_hidden_is_a_linear_loop(options: Options) -> None:
    trial = generate_trial(NOTHING, None, 0.0, np.random.default_rng(3), options)
    y, u = loop_of_matrices(trial, 0)
    trace = trial.recordings[0]
    assert np.abs(trace.role("y") - y).max() < 1e-6 * np.abs(y).max()
    assert np.abs(trace.role("u") - u).max() < 1e-6 * np.abs(u).max()
    assert trial.answer.hidden == ()
    assert trial.answer.rho == 0.0


def test_rho_zero_hides_nothing_whatever_the_name() -> None:
    options = Options(controller="proportional", periods=1)
    none, zero = (generate_trial(name, None, 0.0, np.random.default_rng(4), options) for name in (NOTHING, "dead_zone"))
    assert np.array_equal(none.recordings[1].values, zero.recordings[1].values)
    assert zero.answer.hidden == ()


def test_observer_loop_is_the_augmented_controller_of_the_book() -> None:
    """alpha enters an observer x+ = A x + B u + L (C x - y), u = F x + alpha; gains by python-control."""
    import control

    machine = Options(controller="lqg").build()
    Ad, Bd, C = sampled(machine, machine.nominal)
    F = -control.dlqr(Ad, Bd, np.diag([0, 0, 1e-4, 1e-4, 0, 0]), np.eye(2))[0]
    L = -control.dlqr(Ad.T, C.T, 0.01 * np.eye(6), np.eye(2))[0].T
    rng = np.random.default_rng(0)
    y, alpha, x, xk = rng.normal(size=(50, 2)), rng.normal(size=(50, 2)), np.zeros(6), np.zeros(6)
    for k in range(50):
        u = F @ x + alpha[k]
        x = Ad @ x + Bd @ u + L @ (C @ x - y[k])
        entry = np.concatenate([y[k], alpha[k]])
        assert u == pytest.approx(machine.loop.C @ xk + machine.loop.D @ entry, rel=1e-6, abs=1e-9)
        xk = machine.loop.A @ xk + machine.loop.B @ entry


def test_published_feedback_gain_is_reproduced() -> None:
    """P5 (12) of the thesis, columns in the order of the states: 2.358 0.101 -0.0039 -0.0002 -5.159 0.039."""
    machine = Options(controller="lqg").build()
    assert machine.loop.C[0] == pytest.approx([2.358, 0.101, -0.0039, -0.0002, -5.159, 0.039], abs=6e-4)


def test_nominal_matrices_are_those_of_the_published_plant() -> None:
    from afdsvc.plants.gas_bearing import gas_bearing

    machine = Options().build()
    plant = gas_bearing(0)
    built = plant.build({name: q.value for name, q in plant.parameters.items()})
    for mine, published in zip(machine.matrices(machine.nominal), (built.A, built.B, built.C), strict=True):
        assert np.allclose(mine, published, rtol=1e-12)


def test_integrator_converges_with_its_step() -> None:
    """Halving the step of a strongly nonlinear case changes the outputs by less than a thousandth of the noise."""
    from dataclasses import replace

    from afdsvc.trial.simulation import play_run

    trial = generate_trial("clearance", "state:horizontal_rate", 1.0, np.random.default_rng(5), Options(controller="proportional", periods=1))
    fine = replace(trial.machine, substeps=2 * trial.machine.substeps)
    apart = play_run(fine, trial.truth, trial.runs[1]).y - trial.played[1].y
    assert np.abs(apart).max() < 1e-3 * trial.machine.sigma.min()


def test_a_replay_reads_nothing_beyond_what_it_is_given(monkeypatch) -> None:
    """Uncompiled, where Python looks at every index: compiled code would read on and, at the end of the heap, crash."""
    trial = generate_trial(NOTHING, None, 0.0, np.random.default_rng(3), Options(controller="proportional", periods=1))
    short = trial.runs[0]
    n = 40
    cut = {name: getattr(short, name)[:n] for name in ("alpha", "ref", "noise", "colour", "push")}
    short = replace(short, aux=short.aux[: n + 1], **cut)
    compiled = play_run(trial.machine, trial.truth, short)
    monkeypatch.setattr("afdsvc.trial.simulation.integrate", simulation.integrate.py_func)
    assert np.allclose(play_run(trial.machine, trial.truth, short).y, compiled.y)
    assert np.allclose(replay(trial.machine, trial.truth, short, compiled.u).y, compiled.y)
