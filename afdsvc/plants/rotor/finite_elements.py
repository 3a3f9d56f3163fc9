"""A flexible rotor by finite elements: shaft, discs and gyroscopics, as mass, stiffness, damping and gyroscopic matrices.

Every node has four degrees of freedom in the order ``(x, y, slope of x, slope of y)``, the slopes against the shaft axis;
node n starts at row ``4 n``. ``M q'' + (C + speed G) q' + K q = f`` in SI units, the speed in rad/s. The shaft is free:
bearings are added by whoever knows them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array
from afdsvc.plants.rotor.elements import Element, PlaneMatrices, plane_matrices

DOFS = 4
AXES = ("x", "y")


@dataclass(frozen=True, slots=True)
class Disc:
    """A rigid disc at a node: mass [kg], diametral and polar moment of inertia [kg m^2]."""

    node: int
    mass: float
    diametral: float
    polar: float


@dataclass(frozen=True, slots=True, eq=False)
class RotorMatrices:
    """Mass ``M``, damping ``C``, gyroscopic matrix ``G`` per rad/s and stiffness ``K`` of a free rotor, ``(4 nodes,) * 2``."""

    M: Array
    C: Array
    G: Array
    K: Array

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return len(self.M) // DOFS

    def direction(self, node: int, axis: int) -> Array:
        """Return the unit vector of the displacement at a node, axis 0 for x and 1 for y; raises `BadInput`."""
        if not (0 <= node < self.nodes and axis in (0, 1)):
            raise BadInput(f"node {node}, axis {axis}: the rotor has nodes 0 to {self.nodes - 1} and axes 0 (x) and 1 (y)")
        unit = np.zeros(len(self.M))
        unit[DOFS * node + axis] = 1.0
        return unit

    def total_mass(self) -> float:
        """Return the mass of the rotor [kg]."""
        x = np.zeros(len(self.M))
        x[0::DOFS] = 1.0
        return float(x @ self.M @ x)

    def damped(self, seconds: float) -> RotorMatrices:
        """Return the rotor with stiffness-proportional damping ``C = seconds K``: rigid motion stays undamped."""
        return replace(self, C=seconds * self.K)


def rotor_matrices(elements: Sequence[Element], discs: Sequence[Disc] = ()) -> RotorMatrices:
    """Return the matrices of a free rotor of ``len(elements) + 1`` nodes, without damping.

    Raises `BadInput` for a disc at a node that does not exist.
    """
    size = DOFS * (len(elements) + 1)
    M, K, G = (np.zeros((size, size)) for _ in range(3))
    for i, element in enumerate(elements):
        _add(M, K, G, plane_matrices(element), DOFS * i, 2)
    for disc in discs:
        if not 0 <= disc.node <= len(elements):
            raise BadInput(f"a disc sits at node {disc.node}; the rotor has nodes 0 to {len(elements)}")
        mass, polar = np.diag([disc.mass, disc.diametral]), np.diag([0.0, disc.polar])
        _add(M, K, G, PlaneMatrices(mass, np.zeros((2, 2)), polar), DOFS * disc.node, 1)
    return RotorMatrices(M, np.zeros_like(M), G, K)


def _add(M: Array, K: Array, G: Array, plane: PlaneMatrices, first: int, ends: int) -> None:
    """Add the matrices of one plane to both planes; rotation takes x into y: ``J_d b'' = i speed J_p b'``, b = bx + i by."""
    x = np.array([first + DOFS * end + part for end in range(ends) for part in (0, 2)])
    y = x + 1
    for own in (x, y):
        M[np.ix_(own, own)] += plane.mass
        K[np.ix_(own, own)] += plane.stiffness
    G[np.ix_(x, y)] += plane.polar
    G[np.ix_(y, x)] -= plane.polar
