"""Rotors modelled with ROSS, as plants: their matrices in the order of `afdsvc.plants.rotor.finite_elements`.

Needs the extra ``rotor`` (ross-rotordynamics with plotly below 7), which takes seconds to import and is imported only when
one of these functions is called.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array
from afdsvc.plants.rotor.finite_elements import RotorMatrices

ROSS_DOFS = 6  # x, y, z, rotation about x, about y, about z
ORDER, SIGNS = (0, 1, 4, 3), (1.0, 1.0, 1.0, -1.0)  # slope of x turns about y, slope of y about minus x


def rotor_from_ross(rotor: Any) -> RotorMatrices:
    """Return the matrices of the shaft and discs of a ``ross.Rotor``, without its bearings and axial and torsional motion.

    Raises `BadInput` when ROSS is not installed or the rotor's nodes do not have six degrees of freedom each.
    """
    ross = _ross()
    return from_six(*_free(ross, rotor))


def from_six(M: Array, C: Array, G: Array, K: Array) -> RotorMatrices:
    """Return matrices in ROSS's six degrees of freedom per node as those of lateral motion; raises `BadInput` for sizes."""
    if len(M) % ROSS_DOFS:
        raise BadInput(f"the rotor has {len(M)} degrees of freedom; expected six for each node")
    nodes = len(M) // ROSS_DOFS
    keep = (ROSS_DOFS * np.arange(nodes)[:, None] + np.array(ORDER)).ravel()
    sign = np.tile(SIGNS, nodes)

    def lateral(X: Array) -> Array:
        return np.asarray(sign[:, None] * np.asarray(X, dtype=np.float64)[np.ix_(keep, keep)] * sign)

    return RotorMatrices(lateral(M), lateral(C), lateral(G), lateral(K))


def _free(ross: Any, rotor: Any) -> tuple[Array, Array, Array, Array]:
    """Return M, C, G, K of the rotor without bearings."""
    free = ross.Rotor(rotor.shaft_elements, rotor.disk_elements)
    return free.M(), free.C(0), free.G(), free.K(0)


def _ross() -> Any:
    try:
        return import_module("ross")
    except ImportError as missing:
        raise BadInput(f"ROSS cannot be imported ({missing}); install it with: pip install 'afdsvc[rotor]'") from missing
