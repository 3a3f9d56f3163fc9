"""Assembled rotors against beams and rigid bodies whose motion is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import eigh

from afdsvc.errors import BadInput
from afdsvc.plants.rotor.finite_elements import STEEL, Disc, Element, plane_matrices, rotor_matrices

# roots of cos(x) cosh(x) = 1: bending of a free uniform beam
FREE_BEAM = (4.730040745, 7.853204624, 10.99560784)


def test_slender_free_shaft_bends_at_the_known_frequencies() -> None:
    length, diameter = 2.0, 0.01
    rotor = rotor_matrices([Element(length / 39, diameter)] * 39)
    square = eigh(rotor.K, rotor.M, eigvals_only=True)
    stiffness = np.sqrt(STEEL.young * (np.pi / 64 * diameter**4) / (STEEL.density * np.pi / 4 * diameter**2))
    wanted = [(x / length) ** 2 * stiffness for x in FREE_BEAM]
    assert np.abs(square[:4]).max() < 1e-6 * square[4]
    # both planes bend alike; rotary inertia takes (pi d / 4 l)^2 or so
    assert np.sqrt(square[4:10]) == pytest.approx(np.repeat(wanted, 2), rel=3e-4)


def test_disc_on_stiff_springs_whirls_as_gyroscopics_say() -> None:
    """Tilt b = bx + i by of a rigid rotor on a tilting spring: ``J_d b'' - i speed J_p b' + k b = 0``."""
    rotor = rotor_matrices([Element(1e-3, 1e-3)], [Disc(0, 1.0, 0.02, 0.03)])
    speed, spring = 900.0, 5000.0
    tilt = [2, 3]
    M, G = rotor.M[np.ix_(tilt, tilt)], rotor.G[np.ix_(tilt, tilt)]
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, spring * np.eye(2)), -np.linalg.solve(M, speed * G)]])
    wanted = np.abs(np.roots([0.02, -0.03 * speed, -spring]))  # b = exp(i w t): J_d w^2 - speed J_p w - k = 0
    assert np.sort(np.abs(np.linalg.eigvals(A))) == pytest.approx(np.sort(np.repeat(wanted, 2)), rel=1e-6)
    values, vectors = np.linalg.eig(A)
    fastest = int(np.argmax(values.imag))
    # the fast whirl runs ahead with the rotation, from x to y: b_y = -i b_x for exp(+ i w t)
    assert vectors[1, fastest] / vectors[0, fastest] == pytest.approx(-1j, abs=1e-6)


def test_matrices_have_their_symmetries_and_the_mass_is_the_sum() -> None:
    rotor = rotor_matrices([Element(0.1, 0.05), Element(0.2, 0.08, shear=True)], [Disc(1, 3.0, 0.01, 0.02)])
    assert np.array_equal(rotor.G, -rotor.G.T)
    assert np.allclose(rotor.M, rotor.M.T, rtol=0, atol=1e-15)
    assert np.linalg.eigvalsh(rotor.M).min() > 0
    wanted = 3.0 + 7850 * np.pi / 4 * (0.05**2 * 0.1 + 0.08**2 * 0.2)
    assert rotor.total_mass() == pytest.approx(wanted, rel=1e-12)
    assert np.array_equal(rotor.damped(1e-6).C, 1e-6 * rotor.K)


def test_nodes_that_do_not_exist_are_refused() -> None:
    with pytest.raises(BadInput, match="nodes 0 to 1"):
        rotor_matrices([Element(0.1, 0.05)], [Disc(2, 1.0, 0.1, 0.1)])
    with pytest.raises(BadInput, match="nodes 0 to 1 and axes 0"):
        rotor_matrices([Element(0.1, 0.05)]).direction(1, 2)


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
