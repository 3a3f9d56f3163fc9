"""A flexible rotor by finite elements: shaft, discs and gyroscopics, as mass, stiffness, damping and gyroscopic matrices.

Every node has four degrees of freedom in the order ``(x, y, slope of x, slope of y)``, the slopes against the shaft axis;
node n starts at row ``4 n``. ``M q'' + (C + speed G) q' + K q = f`` in SI units, the speed in rad/s. The shaft is free:
bearings are added by whoever knows them.

The beam element of a rotating shaft: mass, stiffness and gyroscopic coupling of one plane, by Gauss quadrature.

One plane has two degrees of freedom at each end of the element, displacement and slope: ``(d1, s1, d2, s2)``. The
exact static shape functions of a Timoshenko beam are integrated with four Gauss points, which is exact for them; with
the shear factor 0 they are the cubic Hermite functions of the Euler-Bernoulli beam with rotary inertia.

Source: H. D. Nelson, "A finite rotating shaft element using Timoshenko beam theory", J. Mechanical Design 102 (1980).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True)
class Material:
    """Young's modulus [Pa], density [kg/m^3] and Poisson's ratio of a shaft."""

    young: float
    density: float
    poisson: float


STEEL = Material(2.1e11, 7850.0, 0.3)


@dataclass(frozen=True, slots=True)
class Element:
    """A round shaft element: length and diameter [m], a material, and whether shear is counted (Timoshenko)."""

    length: float
    diameter: float
    material: Material = STEEL
    shear: bool = False

    def __post_init__(self) -> None:
        if not (self.length > 0 and self.diameter > 0):
            raise BadInput(f"shaft element of length {self.length} m and diameter {self.diameter} m; expected positive")

    @property
    def area(self) -> float:
        """Cross-section [m^2]."""
        return float(np.pi / 4 * self.diameter**2)

    @property
    def second_moment(self) -> float:
        """Second moment of area about a diameter [m^4]."""
        return float(np.pi / 64 * self.diameter**4)

    @property
    def shear_stiffness(self) -> float:
        """``kappa G A`` [N], Cowper's shear coefficient of a round section; infinite without shear."""
        if not self.shear:
            return float("inf")
        nu = self.material.poisson
        return 6 * (1 + nu) / (7 + 6 * nu) * self.material.young / (2 * (1 + nu)) * self.area


@dataclass(frozen=True, slots=True, eq=False)
class PlaneMatrices:
    """Mass, stiffness and polar inertia ``(4, 4)`` of one plane; the polar inertia couples the planes when rotating."""

    mass: Array
    stiffness: Array
    polar: Array


def plane_matrices(element: Element) -> PlaneMatrices:
    """Return the matrices of one element in SI units."""
    E, rho, inertia = element.material.young, element.material.density, element.second_moment
    length, shear = element.length, element.shear_stiffness
    phi = 12 * E * inertia / (shear * length**2)
    points, weights = legendre.leggauss(4)
    mass, stiffness, polar = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4))
    for xi, weight in zip((points + 1) / 2, weights * length / 2, strict=True):
        d, s = _displacement_shape(xi, length, phi), _slope_shape(xi, length, phi)
        bend = _slope_derivative(xi, length, phi)
        rotary = rho * inertia * np.outer(s, s)
        mass += weight * (rho * element.area * np.outer(d, d) + rotary)
        polar += weight * 2 * rotary
        stiffness += weight * E * inertia * np.outer(bend, bend)
    if element.shear:
        strain = _shear_strain(length, phi)
        stiffness += length * shear * np.outer(strain, strain)
    return PlaneMatrices(mass, stiffness, polar)


def _displacement_shape(xi: float, length: float, phi: float) -> Array:
    """Return the displacement at ``xi`` in [0, 1] for unit ``(d1, s1, d2, s2)``."""
    half = phi / 2 * (xi - xi**2)
    return np.array(
        [
            1 - 3 * xi**2 + 2 * xi**3 + phi * (1 - xi),
            length * (xi - 2 * xi**2 + xi**3 + half),
            3 * xi**2 - 2 * xi**3 + phi * xi,
            length * (xi**3 - xi**2 - half),
        ]
    ) / (1 + phi)


def _slope_shape(xi: float, length: float, phi: float) -> Array:
    """Return the rotation of the cross-section at ``xi``."""
    bow = 6 * (xi - xi**2) / length
    return np.array([-bow, 1 - 4 * xi + 3 * xi**2 + phi * (1 - xi), bow, 3 * xi**2 - 2 * xi + phi * xi]) / (1 + phi)


def _slope_derivative(xi: float, length: float, phi: float) -> Array:
    """Return the curvature at ``xi``."""
    bow = 6 * (1 - 2 * xi) / length
    return np.array([-bow, 6 * xi - 4 - phi, bow, 6 * xi - 2 + phi]) / ((1 + phi) * length)


def _shear_strain(length: float, phi: float) -> Array:
    """Return the shear strain ``d' - s``, which is constant along the element."""
    return np.array([-1 / length, -0.5, 1 / length, -0.5]) * phi / (1 + phi)


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
