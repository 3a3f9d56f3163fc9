"""A recording whose inputs are written down after the answer to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.signals import Trace
from afdsvc.explain.pipeline import explain
from afdsvc.plugins.physics import afdsvc_physics
from tests.explain.motor import DT, model, recording

LIBRARY = [p for p in afdsvc_physics() if p.name in ("clock_offset", "transport_delay", "coulomb_friction", "stribeck_friction", "flexible_mode", "hysteresis", "resonant_actuator")]


def late(trace: Trace) -> Trace:
    """Return the recording with every input beside the output of one sample later."""
    return replace(trace, values=np.column_stack([trace.values[:-1, 0], trace.values[1:, 1]]))


def test_a_late_clock_is_named_beside_what_the_machine_lacks():
    runs = [recording(60.0, seed) for seed in (1, 2, 3)]
    named = explain(model(), [late(r) for r in runs[:2]], [late(runs[2])], LIBRARY, experiment=False).named
    first, second = (next(n for n in named if n.effect == k) for k in (1, 2))  # friction with a breakaway force, of unknown size, may fit alike
    assert [first.physics, second.physics] == ["coulomb_friction", "clock_offset"]
    assert {n.physics for n in named} <= {"coulomb_friction", "stribeck_friction", "clock_offset"}
    assert second.parameters["offset"].value == pytest.approx(DT, rel=0.3)
    assert "clock_offset" not in {n.physics for n in explain(model(), runs[:2], runs[2:], LIBRARY, experiment=False).named}
