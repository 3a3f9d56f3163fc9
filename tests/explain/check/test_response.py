"""An output that does not respond to the inputs is refused by name."""

from __future__ import annotations

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter, lsim

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.check.check import check, objection
from afdsvc.explain.check.response import _correlation, _largest, _simulated, responding
from afdsvc.explain.check.result import check_all
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.lti.statespace import StateSpace


def noise(trace, seed: int, output: bool = False):
    """The recording with its input replaced by white noise (and, with ``output``, what is measured too)."""
    values = trace.values.copy()
    rng = np.random.default_rng(seed)
    values[:, 0] = rng.standard_normal(len(values))
    if output:
        values[:, 1] = rng.standard_normal(len(values))
    return replace(trace, values=values)


def steps(seed: int, gain: float) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Outputs and inputs of twelve short recordings: slow inputs, and an output that follows them with a gain in noise as slow."""
    rng = np.random.default_rng(seed)
    slow = [lfilter([1.0], [1, -0.95], rng.standard_normal((2, 60))) for _ in range(12)]
    return [gain * u + e - (gain * u + e).mean() for u, e in slow], [u - u.mean() for u, _ in slow]


def test_short_recordings_show_together_what_none_shows_alone():
    outputs, inputs = steps(1, 0.8)
    assert not any(_largest([y], [u])[1] for y, u in zip(outputs, inputs, strict=True))
    assert _largest(outputs, inputs)[1]
    runs = [SimpleNamespace(U=u[:, None], Y=y[:, None]) for y, u in zip(outputs, inputs, strict=True)]
    assert _correlation(runs, [np.zeros((60, 1))] * 12, 0)[1]
    assert sum(_largest(*steps(seed, 0.0))[1] for seed in range(2, 302)) <= 3  # 0.1 % promised


@pytest.mark.parametrize("related", [True, False])
def test_what_integrates_its_input_responds_though_it_wanders(related):
    """A cylinder that follows random levels in a loop that is not stated: its position is hardly correlated with the valve, its changes are."""
    plant = StateSpace(np.array([[0.0, 1.0], [0.0, -20.0]]), np.array([[0.0], [600.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1)))
    model = Model("cylinder", (Variable("valve", "V"),), (Variable("position", "mm"),), (Variable("q", "mm"), Variable("v", "mm/s", rate_of="q")), plant)

    def played(seed: int, n: int = 3000, dt: float = 2e-3) -> tuple[np.ndarray, np.ndarray]:
        rng, q, v, rows = np.random.default_rng(seed), 0.0, 0.0, []
        for level in np.repeat(rng.uniform(-40, 40, n // 400 + 1), 400)[:n]:
            u = float(np.clip(0.1 * (level - q), -9, 9))
            rows.append((u, q + 0.05 * rng.standard_normal()))
            v += dt * (600 * np.sign(u) * max(abs(u) - 0.5, 0.0) - 20 * v)
            q += dt * v
        return np.array(rows)[:, 0], np.array(rows)[:, 1]

    valves = [played(seed if related else seed + 10)[0] for seed in (5, 6)]
    traces = [Trace(f"r{k}", 2e-3, (Channel("u_valve"), Channel("y_position")), np.column_stack([u, played(k)[1]])) for k, u in enumerate(valves, 5)]
    runs = prepare(model, traces)
    made = _simulated(nominal(model, 2e-3), runs)
    y, *causes = ([x - x.mean() for x in part] for part in ([r.Y[:, 0] for r in runs], [r.U[:, 0] for r in runs], [x[:, 0] for x in made]))
    assert not any(_largest(y, cause)[1] for cause in causes)
    assert _correlation(runs, made, 0)[1] == related


@pytest.mark.parametrize("seed", [1, 2])
def test_two_unrelated_signals_are_refused_by_name(spring, recorded, seed):
    refused = objection(check(spring, [noise(recorded(k), 10 * seed + k, True) for k in (1, 2)]))
    assert "y_position does not respond to u_force" in refused


def test_an_output_that_moves_too_slowly_for_a_test_is_doubted(spring, recorded):
    """A temperature in the place of the position: nothing refuses it, and nothing says that it follows the force."""
    traces = [noise(recorded(k), k) for k in (1, 2)]
    traces = [replace(t, values=np.column_stack([t.values[:, 0], 40 + 0.1 * t.values[:, 1].std() * np.sin(np.arange(len(t)) * 6.0 / len(t))])) for t in traces]
    runs = prepare(spring, traces)
    (found,) = responding(nominal(spring, runs[0].dt), runs)
    assert found.kind == "warning"
    assert "y_position is not clearly correlated with u_force" in found.sentence


def test_a_step_response_is_not_doubted_for_being_slow(spring, recorded):
    """Two steps in a recording are two independent samples of the input: nothing can be tested, but the response is plain."""
    t = recorded(1)
    n, dt = len(t), t.dt
    u = np.where(np.arange(n) < n // 2, 1.0, 2.0)
    slow = replace(spring, plant=replace(spring.plant, A=np.array([[0.0, 1.0], [-1.0, -1.5]]) * np.array([[1.0], [1 / (n * dt / 20) ** 2]])))
    y = lsim((slow.plant.A, slow.plant.B, slow.plant.C, slow.plant.D), u, dt * np.arange(n), interp=False)[1]
    runs = prepare(slow, [replace(t, values=np.column_stack([u, 1.3 * y]))])
    assert list(responding(nominal(slow, dt), runs)) == []


def test_an_output_that_responds_raises_no_objection(spring, recorded):
    runs = prepare(spring, [recorded(k, noise=0.5) for k in (1, 2)])
    assert list(responding(nominal(spring, runs[0].dt), runs)) == []


def test_an_output_that_follows_the_models_simulation_needs_no_further_test(spring, recorded, monkeypatch):
    """A mode that rings under white noise is hardly correlated with its input at any one lag."""
    ringing = replace(spring, plant=replace(spring.plant, A=np.array([[0.0, 1.0], [-400.0, -8.0]])))
    rng = np.random.default_rng(3)
    u, t = rng.standard_normal(8000), recorded(1)
    dt = t.dt
    y = lsim((ringing.plant.A, ringing.plant.B, ringing.plant.C, ringing.plant.D), u, dt * np.arange(8000), interp=False)[1]
    runs = prepare(ringing, [replace(t, values=np.column_stack([u, y + 0.1 * y.std() * rng.standard_normal(8000)]))])
    monkeypatch.setattr(sys.modules[responding.__module__], "gap_test", lambda *_, **__: pytest.fail("the gap test was asked"))
    assert list(responding(nominal(ringing, dt), runs)) == []


def test_an_output_that_follows_the_size_of_the_input_responds(spring, recorded):
    traces = [noise(recorded(k), k) for k in (1, 2)]
    traces = [replace(t, values=np.column_stack([t.values[:, 0], np.abs(t.values[:, 0])])) for t in traces]
    runs = prepare(spring, traces)
    assert list(responding(nominal(spring, runs[0].dt), runs)) == []


def test_a_machine_without_inputs_is_not_asked(spring, recorded):
    free = replace(spring, inputs=(), plant=replace(spring.plant, B=np.zeros((2, 0)), D=np.zeros((1, 0))))
    trace = recorded(1, decay=True)
    runs = prepare(free, [trace])
    assert list(responding(nominal(free, runs[0].dt), runs)) == []
    assert "has no inputs" in check_all(free, [trace], []).plan.sentence


def test_a_reference_excites_a_loop_whose_controller_is_known():
    """The controller makes all of the input from the reference: nothing is added to its output."""
    one = np.eye(1)
    controller = StateSpace(one, -0.02 * one, one, -2 * one, dt=0.01)
    axis = Model("axis", (Variable("u", "V"),), (Variable("y", "m"),), (Variable("x", "m"),), StateSpace(0 * one, one, one, 0 * one), controller=controller)
    rng, x, w, rows = np.random.default_rng(1), 0.0, 0.0, []
    for reference in np.repeat(rng.normal(size=20), 100):
        error = x + 1e-3 * rng.normal() - reference
        u = w - 2 * error
        rows.append((u, error + reference, reference))
        w, x = w - 0.02 * error, x + 0.01 * u
    loop = Trace("loop", 0.01, (Channel("u_u"), Channel("y_y"), Channel("ref_y")), np.array(rows))
    findings = check(axis, [loop])
    assert [f for f in findings if f.kind == "stop"] == []


def test_a_short_recording_in_which_the_output_hardly_moves_is_refused(spring, recorded):
    """Too few blocks for the test of the response; the stable model says that the output moves a thousand times as much."""
    trace = recorded(1)
    values = trace.values[:60].copy()
    values[:, 1] = 1e-3 * np.random.default_rng(3).standard_normal(60) * trace.values[:, 1].std()
    (said,) = responding(nominal(spring, trace.dt), prepare(spring, [replace(trace, values=values)]))
    assert said.kind == "stop"
    assert "is not correlated with the inputs" in said.sentence


def test_a_short_recording_in_which_the_output_moves_as_if_alone_is_doubted(spring, recorded):
    trace = recorded(1)
    values = trace.values[:60].copy()
    values[:, 1] = 0.3 * np.random.default_rng(3).standard_normal(60) * trace.values[:, 1].std()
    (said,) = responding(nominal(spring, trace.dt), prepare(spring, [replace(trace, values=values)]))
    assert said.kind == "warning"
    assert "is not clearly correlated with u_force" in said.sentence
