"""What a burst answered lies on the curve of the fault that is there, at its severity; healthy bursts lie at the origin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from afdsvc.app.review import fault_planes
from afdsvc.files.recording.reader import Recording

SHIPPED = Path(__file__).parents[2] / "recordings" / "shipped"
FAULTS = ("horizontal_actuator", "vertical_actuator", "horizontal_sensor", "vertical_sensor")


def planes(name: str):
    return fault_planes(Recording(SHIPPED / f"gas_bearing_{name}.mcap"), "bearing")


@pytest.mark.parametrize("fault", FAULTS)
def test_the_measured_points_lie_on_the_fault_s_curve_at_its_severity(fault):
    """The shipped recordings carry a loss of a half. Coordinates are standard deviations, so 4 is far for noise, and loud for none."""
    found = planes(fault)
    assert found
    for plane in found:
        curve = plane.curves[fault]
        severities = np.linspace(0, plane.ends[fault], len(curve))
        at_half = np.array([np.interp(0.5, -severities, curve[:, i]) for i in (0, 1)])
        for point in plane.points:
            assert np.linalg.norm(np.array(point.value) - at_half) < 4.5
    assert max(np.linalg.norm(p.value) for p in found[0].points) > 20


def test_a_healthy_machine_answers_nothing_but_noise():
    for plane in planes("nominal"):
        for point in plane.points:
            assert np.linalg.norm(point.value) < 4.5
        for curve in plane.curves.values():
            np.testing.assert_allclose(curve[0], 0.0, atol=1e-9)
