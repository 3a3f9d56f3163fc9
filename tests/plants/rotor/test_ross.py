"""The bridge from ROSS: the order of its degrees of freedom, and one sentence when it is missing."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.plants.rotor.finite_elements import Disc, Element, rotor_matrices
from afdsvc.plants.rotor.ross import from_six, rotor_from_ross


def test_lateral_motion_is_picked_in_our_order_and_signs() -> None:
    """Our own matrices written in ROSS's order (x, y, z, about x, about y, about z) come back as they were."""
    ours = rotor_matrices([Element(0.1, 0.05), Element(0.2, 0.06)], [Disc(1, 2.0, 0.01, 0.02)])
    place = np.zeros((18, 12))
    for node in range(3):
        for own, theirs, sign in ((0, 0, 1), (1, 1, 1), (2, 4, 1), (3, 3, -1)):
            place[6 * node + theirs, 4 * node + own] = sign
    back = from_six(*(place @ X @ place.T for X in (ours.M, ours.C, ours.G, ours.K)))
    assert all(np.array_equal(getattr(back, m), getattr(ours, m)) for m in "MCGK")


def test_other_sizes_are_refused() -> None:
    with pytest.raises(BadInput, match="six for each node"):
        from_six(*(np.eye(8) for _ in range(4)))


def test_without_the_extra_one_sentence_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ross", None)
    with pytest.raises(BadInput, match=r"pip install 'afdsvc\[rotor\]'"):
        rotor_from_ross(None)


def test_same_shaft_from_ross() -> None:
    """ROSS's own Timoshenko element, discs and gyroscopics against ours, entry by entry; runs where ROSS is installed."""
    ross = pytest.importorskip("ross")
    steel = ross.Material("steel_of_ours", rho=7850, E=2.1e11, G_s=2.1e11 / 2.6)
    shaft = [ross.ShaftElement(L=0.05, idl=0, odl=d, material=steel, n=i) for i, d in enumerate((0.05, 0.08))]
    theirs = rotor_from_ross(ross.Rotor(shaft, [ross.DiskElement(n=1, m=2.0, Id=0.01, Ip=0.02)]))
    ours = rotor_matrices([Element(0.05, d, shear=True) for d in (0.05, 0.08)], [Disc(1, 2.0, 0.01, 0.02)])
    for m in "MGK":
        a, b = getattr(theirs, m), getattr(ours, m)
        assert np.abs(a - b).max() < 1e-9 * np.abs(b).max()
