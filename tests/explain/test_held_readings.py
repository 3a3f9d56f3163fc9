"""A sensor that is read less often than samples are recorded: no delay, and what is missing is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.pipeline import explain
from afdsvc.explain.search.build import build
from afdsvc.explain.search.problem import loop_known
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT, EVERY = 0.01, 8
LIBRARY = [p for p in afdsvc_physics() if p.name in ("coulomb_friction", "transport_delay", "sensor_lag")]
MOTOR = Model("motor", (Variable("voltage", "V"),), (Variable("speed", "rad/s"),), (Variable("speed", "rad/s"),), StateSpace.of([[-4.0]], [[40.0]], [[1.0]]))
AXIS = Model(
    "axis", (Variable("voltage", "V"),), (Variable("angle", "rad"),), (Variable("angle", "rad"), Variable("speed", "rad/s", rate_of="angle")),
    StateSpace.of([[0.0, 1.0], [0.0, -4.0]], [[0.0], [40.0]], [[1.0, 0.0]]),
)


def recording(seed: int, friction: float, model: Model) -> Trace:
    """Return a motor at random voltages, whose sensor is read at one sample of 8; where its angle is read a loop keeps it near a moving goal."""
    rng = np.random.default_rng(seed)
    goal, q, w, rows, shown = np.repeat(rng.normal(size=60), 25), 0.0, 0.0, [], 0.0
    for k, r in enumerate(goal):
        if k % EVERY == 3:
            shown = (w if model is MOTOR else q) + 0.02 * rng.standard_normal()
        u = r if model is MOTOR else np.clip(0.8 * (r - shown), -2, 2) + 0.1 * rng.standard_normal()
        rows.append((u, shown))
        for _ in range(20):
            w += DT / 20 * (-4 * w + 40 * u)
            w = np.sign(w) * max(abs(w) - friction * DT / 20, 0.0)
            q += DT / 20 * w
    return Trace(f"r{seed}", DT, (Channel("u_voltage", "V"), Channel(f"y_{model.outputs[0].name}", model.outputs[0].unit)), np.array(rows))


@pytest.mark.parametrize(("model", "friction"), [(MOTOR, 10.0), (AXIS, 0.0)], ids=["motor", "axis"])
def test_friction_is_named_where_there_is_some_and_no_delay(model, friction):
    *given, held = (recording(seed, friction, model) for seed in (1, 2, 3))
    found = explain(model, given, [held], LIBRARY, experiment=False)
    assert [n.physics for n in found.named] == ["coulomb_friction"] * (friction > 0)
    assert found.verdict == ("omitted_physics" if friction else "consistent")
    assert found.fit[0].after_nrmse < 0.05
    assert not any("late" in sentence for sentence in found.check)


def test_a_loop_is_not_closed_around_a_controller_that_saw_what_was_held():
    model = replace(AXIS, controller=StateSpace.of([[0.0]], [[1.0]], [[0.0]], [[-0.8]], DT))
    trace = recording(1, 0.0, AXIS)
    fine = replace(trace, values=trace.values + [0.0, 1e-9] * np.random.default_rng(0).standard_normal(trace.values.shape))
    assert [loop_known(build(nominal(model, DT), prepare(model, [t]), Settings())) for t in (trace, fine)] == [False, True]
