"""Pseudo-modal reduction: an exact splitting of the full model, in real form, whatever the speed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.statespace import Array
from afdsvc.plants.amb_turboexpander import turboexpander_rotor
from afdsvc.plants.rotor.magnetic_rotor import MagneticRotor
from afdsvc.plants.rotor.modes import slowest_modes

OMEGA = np.array([1.0, 150.0, 300.0, 3299.0, 12000.0, 22000.0, 60000.0])


def nominal(rotor: MagneticRotor) -> dict[str, float]:
    return {name: q.value for name, q in rotor.parameters().items()}


def by_dynamic_stiffness(rotor: MagneticRotor, omega: Array) -> Array:
    """Return um per A without any mode: ``K - w^2 M + i w (C + speed G)`` solved at each frequency."""
    r, values = rotor.rotor, nominal(rotor)
    at = np.array([r.direction(b.node, axis) for b in rotor.bearings for axis in (0, 1)])
    read = np.array([r.direction(b.sensor, axis) for b in rotor.bearings for axis in (0, 1)])
    K = r.K + at.T @ np.diag([values[f"stiffness_{n}"] for n in rotor.channels]) @ at
    gain = np.diag([values[f"current_gain_{n}"] for n in rotor.channels])
    return np.array([
        1e6 * read @ np.linalg.solve(K - w * w * r.M + 1j * w * (r.C + rotor.speed * r.G), at.T @ gain) for w in omega
    ])  # fmt: skip


@pytest.mark.parametrize("rpm", [0.0, 31500.0])
def test_full_model_is_the_finite_element_model(rpm: float) -> None:
    rotor = turboexpander_rotor(rpm)
    system = rotor.full_system(nominal(rotor))
    assert system.order == 320
    found, wanted = frequency_response(system, OMEGA), by_dynamic_stiffness(rotor, OMEGA)
    assert (np.abs(found - wanted).max(axis=(1, 2)) < 1e-6 * np.abs(wanted).max(axis=(1, 2))).all()


@pytest.mark.parametrize("rpm", [0.0, 6000.0, 31500.0])
@pytest.mark.parametrize("count", [8, 12, 24])
def test_basis_splits_the_full_model_exactly(rpm: float, count: int) -> None:
    """``T_L T_R = I``, both invariant: then poles are kept as they are (and nothing uncontrollable is left over)."""
    rotor = turboexpander_rotor(rpm)
    values = nominal(rotor)
    full, system = rotor.full(values), rotor.full_system(values)
    basis = slowest_modes(full, count, system.C)
    assert basis.left @ basis.right == pytest.approx(np.eye(count), abs=1e-9)
    small = basis.left @ full.A @ basis.right
    size = np.abs(full.A @ basis.right).max()
    assert np.abs(full.A @ basis.right - basis.right @ small).max() < 1e-7 * size
    poles = system.poles()
    wanted = poles[np.argsort(np.abs(poles))][:count]
    found = np.linalg.eigvals(small)
    assert max(np.abs(found - p).min() for p in wanted) < 1e-6 * np.abs(wanted).max()
    assert np.abs(found).max() < basis.next


def test_all_states_lose_nothing() -> None:
    """The residual part is what the kept part leaves: with 60 states the low-frequency error is all but gone."""
    rotor = turboexpander_rotor(31500.0)
    values, w = nominal(rotor), np.array([100.0, 3299.0])
    wanted = by_dynamic_stiffness(rotor, w)
    errors = [np.abs(frequency_response(rotor.reduced(values, n), w) - wanted).max() for n in (8, 16, 32, 60)]
    assert all(b < a for a, b in pairwise(errors))
    assert errors[-1] < 1e-3 * np.abs(wanted).max()


def test_a_pair_is_not_split() -> None:
    with pytest.raises(BadInput, match=r"9 states would split a pair of modes; 4, 8, 10, 12 would not"):
        turboexpander_rotor(31500.0).reduced(nominal(turboexpander_rotor(31500.0)), 9)
