"""The beam element of a rotating shaft: mass, stiffness and gyroscopic coupling of one plane, by Gauss quadrature.

One plane has two degrees of freedom at each end of the element, displacement and slope: ``(d1, s1, d2, s2)``. The
exact static shape functions of a Timoshenko beam are integrated with four Gauss points, which is exact for them; with
the shear factor 0 they are the cubic Hermite functions of the Euler-Bernoulli beam with rotary inertia.

Source: H. D. Nelson, "A finite rotating shaft element using Timoshenko beam theory", J. Mechanical Design 102 (1980).
"""

from __future__ import annotations

from dataclasses import dataclass

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
        d, s = displacement_shape(xi, length, phi), slope_shape(xi, length, phi)
        bend = slope_derivative(xi, length, phi)
        rotary = rho * inertia * np.outer(s, s)
        mass += weight * (rho * element.area * np.outer(d, d) + rotary)
        polar += weight * 2 * rotary
        stiffness += weight * E * inertia * np.outer(bend, bend)
    if element.shear:
        strain = _shear_strain(length, phi)
        stiffness += length * shear * np.outer(strain, strain)
    return PlaneMatrices(mass, stiffness, polar)


def displacement_shape(xi: float, length: float, phi: float) -> Array:
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


def slope_shape(xi: float, length: float, phi: float) -> Array:
    """Return the rotation of the cross-section at ``xi``."""
    bow = 6 * (xi - xi**2) / length
    return np.array([-bow, 1 - 4 * xi + 3 * xi**2 + phi * (1 - xi), bow, 3 * xi**2 - 2 * xi + phi * xi]) / (1 + phi)


def slope_derivative(xi: float, length: float, phi: float) -> Array:
    """Return the curvature at ``xi``."""
    bow = 6 * (1 - 2 * xi) / length
    return np.array([-bow, 6 * xi - 4 - phi, bow, 6 * xi - 2 + phi]) / ((1 + phi) * length)


def _shear_strain(length: float, phi: float) -> Array:
    """Return the shear strain ``d' - s``, which is constant along the element."""
    return np.array([-1 / length, -0.5, 1 / length, -0.5]) * phi / (1 + phi)
