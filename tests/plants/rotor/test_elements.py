"""The beam element against its printed matrices and against elementary beam statics."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.plants.rotor.elements import STEEL, Element, plane_matrices

LENGTH, DIAMETER = 0.05, 0.04


def test_euler_element_is_the_printed_one() -> None:
    """The matrices every textbook prints (Bernoulli-Euler beam with rotary inertia), entry by entry."""
    e, L = Element(LENGTH, DIAMETER), LENGTH
    found = plane_matrices(e)
    bending = np.array([
        [12, 6 * L, -12, 6 * L], [6 * L, 4 * L**2, -6 * L, 2 * L**2],
        [-12, -6 * L, 12, -6 * L], [6 * L, 2 * L**2, -6 * L, 4 * L**2]
    ]) * STEEL.young * e.second_moment / L**3  # fmt: skip
    moving = np.array([
        [156, 22 * L, 54, -13 * L], [22 * L, 4 * L**2, 13 * L, -3 * L**2],
        [54, 13 * L, 156, -22 * L], [-13 * L, -3 * L**2, -22 * L, 4 * L**2],
    ]) * STEEL.density * e.area * L / 420  # fmt: skip
    rotary = np.array([
        [36, 3 * L, -36, 3 * L], [3 * L, 4 * L**2, -3 * L, -(L**2)],
        [-36, -3 * L, 36, -3 * L], [3 * L, -(L**2), -3 * L, 4 * L**2]
    ]) * STEEL.density * e.second_moment / (30 * L)  # fmt: skip
    for matrix, wanted in ((found.stiffness, bending), (found.mass, moving + rotary), (found.polar, 2 * rotary)):
        assert np.abs(matrix - wanted).max() < 1e-13 * np.abs(wanted).max()


@pytest.mark.parametrize("shear", [False, True])
def test_cantilever_sags_as_in_statics(shear: bool) -> None:
    """``F L^3 / 3 E I`` and, with shear, ``F L / kappa G A`` more; both exact for one element."""
    e = Element(LENGTH, DIAMETER, shear=shear)
    free_end = plane_matrices(e).stiffness[2:, 2:]
    sag = np.linalg.solve(free_end, [1.0, 0.0])[0]
    wanted = LENGTH**3 / (3 * STEEL.young * e.second_moment) + LENGTH / e.shear_stiffness
    assert sag == pytest.approx(wanted, rel=1e-12)
    assert bool(LENGTH / e.shear_stiffness > 0.1 * sag) is shear


@pytest.mark.parametrize("shear", [False, True])
def test_rigid_motion_stores_nothing_and_weighs_right(shear: bool) -> None:
    m = plane_matrices(Element(LENGTH, DIAMETER, shear=shear))
    shift, tilt = np.array([1, 0, 1, 0.0]), np.array([-LENGTH / 2, 1, LENGTH / 2, 1])
    assert np.abs(m.stiffness @ np.column_stack([shift, tilt])).max() < 1e-9 * np.abs(m.stiffness).max()
    mass = STEEL.density * np.pi / 4 * DIAMETER**2 * LENGTH
    assert shift @ m.mass @ shift == pytest.approx(mass, rel=1e-12)
    # a cylinder about its middle: transverse m (3 r^2 + l^2) / 12, polar m r^2 / 2
    assert tilt @ m.mass @ tilt == pytest.approx(mass * (3 * (DIAMETER / 2) ** 2 + LENGTH**2) / 12, rel=1e-12)
    assert tilt @ m.polar @ tilt == pytest.approx(mass * (DIAMETER / 2) ** 2 / 2, rel=1e-12)


def test_an_element_has_a_size() -> None:
    with pytest.raises(BadInput, match="expected positive"):
        Element(0.0, 0.1)
