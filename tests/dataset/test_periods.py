"""What turns with the rotor leaves every signal, and nothing else does."""

from __future__ import annotations

import numpy as np

from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.periods import without_rotation

NAMES = tuple(Channel(n, "") for n in ("u_a", "y_a", "aux_angle", "aux_speed"))


def test_waves_of_the_rotor_leave_and_the_rest_stays() -> None:
    """Oracle: a signal made of a mean, two orders and a line orthogonal to them over whole turns."""
    n = 3000
    turn = 2 * np.pi * np.arange(n) / n
    angle, line = np.mod(40 * turn, 2 * np.pi), np.cos(7 * turn)
    u = 2.0 + line + 3 * np.cos(angle + 0.3) - 0.5 * np.sin(2 * angle)
    y = 0.5 * line + np.cos(3 * angle)  # the third order is not taken out
    speed = np.full(n, 40.0)
    left = without_rotation(Trace("t", 1e-3, NAMES, np.column_stack([u, y, angle, speed])))
    assert np.abs(left.column("u_a") - 2.0 - line).max() < 1e-12
    assert np.abs(left.column("y_a") - y).max() < 1e-12
    assert (left.column("aux_angle") == angle).all()
    assert (left.column("aux_speed") == speed).all()


def test_without_an_angle_or_at_rest_nothing_changes() -> None:
    values = np.random.default_rng(1).standard_normal((50, 4))
    bare = Trace("t", 1e-3, NAMES[:2], values[:, :2])
    assert without_rotation(bare) is bare
    values[:, 2] = 0.7
    still = Trace("t", 1e-3, NAMES, values)
    assert without_rotation(still) is still
