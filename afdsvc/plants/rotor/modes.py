"""From the matrices of a rotor to a small model: pseudo-modal reduction with left and right eigenvectors.

The rotor on its magnetic bearings is ``x' = A x + B f, y = C x`` with all its states; the invariant subspace of its
slowest modes gives ``T_L`` and ``T_R`` with ``T_L T_R = I`` and the small model ``T_L A T_R, T_L B, C T_R`` in real form.
Whatever enters the full model (a change of stiffness at a node) is carried into the small one through the same two.

Source: publication P1 of A. K. Sekunda, "Fault Diagnosis and Identification of Electro-Mechanical Systems", PhD thesis,
Technical University of Denmark, 2017, eqs. 17-52. Two things differ. Taking the real and imaginary part of one of each
conjugate pair leaves no uncontrollable copy to remove (eqs. 28-42 keep both and remove one). Modes are sorted by |s|,
not by its imaginary part, which is zero for a fast overdamped mode too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.linalg import eig, eigh

from afdsvc.errors import BadInput, IllConditioned
from afdsvc.lti.statespace import Array, ComplexArray
from afdsvc.plants.rotor.finite_elements import RotorMatrices

RIGID = 4  # motions of a free shaft that bend nothing: two displacements, two tilts
RIGID_SHARE = 1e-6  # of the first bending eigenvalue: what rounding may leave of a zero one


@dataclass(frozen=True, slots=True, eq=False)
class FullRotor:
    """All states of a rotor, in the modes of the free shaft at rest: ``x = (a, a')`` with ``q = shapes a``.

    ``A (2N, 2N)``; a force on the degrees of freedom enters through ``force(direction)``, a displacement is read by
    ``reading(direction)``.
    """

    A: Array
    shapes: Array

    def force(self, direction: Array) -> Array:
        """Return the column of B for a force along ``direction (N,)``."""
        pushed = self.shapes.T @ direction
        return np.concatenate([np.zeros_like(pushed), pushed])

    def reading(self, direction: Array) -> Array:
        """Return the row of C for the displacement along ``direction (N,)``."""
        seen = self.shapes.T @ direction
        return np.concatenate([seen, np.zeros_like(seen)])


def full_rotor(rotor: RotorMatrices, speed: float, stiffness: Array) -> FullRotor:
    """Return the rotor turning at ``speed`` [rad/s] with the stiffness matrix of its bearings ``(N, N)`` added.

    The change of coordinates is exact and only serves accuracy: in the nodes' coordinates the fastest modes of fine
    elements drown the rigid ones in rounding. Raises `IllConditioned` if the free shaft has no four rigid motions.
    """
    square, shapes = eigh(rotor.K, rotor.M)
    if not np.abs(square[:RIGID]).max() < RIGID_SHARE * square[RIGID]:
        raise IllConditioned(f"the free shaft bends with {square[:RIGID]} (rad/s)^2; expected four zeros")
    square[:RIGID] = 0.0
    # a mode of the free shaft is bent by the bearings and coupled to the others by rotation
    K = np.diag(square) + shapes.T @ stiffness @ shapes
    C = shapes.T @ (rotor.C + speed * rotor.G) @ shapes
    n = len(K)
    return FullRotor(np.block([[np.zeros((n, n)), np.eye(n)], [-K, -C]]), shapes)


@dataclass(frozen=True, slots=True, eq=False)
class ModalBasis:
    """``left (n, 2N)`` and ``right (2N, n)`` with ``left @ right = I``; the poles kept, and ``next``, the size of
    the slowest left out."""

    left: Array
    right: Array
    poles: ComplexArray
    next: float


def slowest_modes(full: FullRotor, states: int, outputs: Array) -> ModalBasis:
    """Return the basis of the ``states`` slowest modes (by ``|s|``), scaled so that each moves ``outputs (p, 2N)`` by 1.

    Raises `BadInput` when the number would keep one mode of a pair and drop the other, naming numbers that do not.
    """
    poles, left, right = cast(tuple[ComplexArray, ComplexArray, ComplexArray], eig(full.A, left=True, right=True))
    rank = np.argsort(np.abs(poles), kind="stable")
    _whole(poles[rank], states)
    keep = rank[:states]
    keep = keep[poles[keep].imag >= 0]
    R, L = _real(right[:, keep], poles[keep]), _real(left[:, keep], poles[keep])
    R = R / _pairwise_size(outputs @ R, poles[keep])
    # left vectors of close or repeated poles are made biorthogonal together
    return ModalBasis(np.asarray(np.linalg.solve(L.T @ R, L.T)), R, poles[keep], _next(poles[rank], states))


def _next(poles: ComplexArray, states: int) -> float:
    return float(np.abs(poles[states])) if states < len(poles) else float("inf")


def _whole(poles: ComplexArray, states: int) -> None:
    """Raise `BadInput` unless the first ``states`` poles are separated from the rest."""
    sizes = np.abs(poles)
    clear = [n for n in range(1, len(sizes)) if sizes[n] > sizes[n - 1] * (1 + 1e-3)] + [len(sizes)]
    if states not in clear:
        near = sorted(clear, key=lambda n: abs(n - states))[:4]
        raise BadInput(f"{states} states would split a pair of modes; {', '.join(map(str, sorted(near)))} would not")


def _real(vectors: ComplexArray, poles: ComplexArray) -> Array:
    """Return the real vectors of real poles, the real and imaginary part of one of each conjugate pair."""
    columns: list[Array] = []
    for vector, pole in zip(vectors.T, poles, strict=True):
        columns += [vector.real] if pole.imag == 0 else [vector.real, vector.imag]
    return np.array(columns).T


def _pairwise_size(seen: Array, poles: ComplexArray) -> Array:
    """Return the size of every column of what is seen, one for both columns of a pair."""
    sizes: list[float] = []
    for pole in poles:
        width = 1 if pole.imag == 0 else 2
        sizes += [float(np.linalg.norm(seen[:, len(sizes) : len(sizes) + width]))] * width
    return np.array(sizes)
