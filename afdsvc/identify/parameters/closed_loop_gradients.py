"""Gradients of the matrices of S with respect to those of the plant: the chain rule through the closed loop.

With J_K = ``[y, alpha] -> [u, beta]`` and a plant without feedthrough, S is bilinear in the plant's matrices, so its
slopes follow from theirs exactly, all parameters at once.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.identify.parameters.noise_structure import Slopes
from afdsvc.lti.statespace import Array, StateSpace


def differences(build: Callable[[Array], StateSpace], point: Array, steps: Array) -> Slopes:
    """Return the slopes of the matrices of ``build`` at a point by central differences, shapes ``(q, ...)``."""
    pairs = [(build(point + h), build(point - h)) for h in np.diag(steps)]

    def slope(name: str) -> Array:
        return np.stack(
            [(getattr(a, name) - getattr(b, name)) / (2 * h) for (a, b), h in zip(pairs, steps, strict=True)]
        )

    return Slopes(slope("A"), slope("B"), slope("C"), slope("D"))


def closed_slopes(augmented: StateSpace, plant: StateSpace, moved: Slopes) -> Slopes:
    """Return the slopes of ``S = F_u(J_K, G)`` from those of G, stacked ``(q, rows, columns)``.

    The states are those of the plant, then those of J_K (as `afdsvc.lti.lft.star` orders them). Raises `BadInput` for a
    plant with feedthrough.
    """
    if plant.D.any() or moved.D.any():
        raise BadInput("the plant has a feedthrough; the slopes of S are bilinear only without one")
    q, n, k, p, m = len(moved.A), plant.order, augmented.order, plant.outputs, plant.inputs
    from_y, to_u = augmented.B[:, :p], augmented.C[:m]
    direct, excited, seen = augmented.D[:m, :p], augmented.D[:m, p:], augmented.D[m:, :p]
    A, B = np.zeros((q, n + k, n + k)), np.zeros((q, n + k, excited.shape[1]))
    C = np.zeros((q, len(seen), n + k))
    A[:, :n, :n] = moved.A + moved.B @ (direct @ plant.C) + (plant.B @ direct) @ moved.C
    A[:, :n, n:], A[:, n:, :n] = moved.B @ to_u, from_y @ moved.C
    B[:, :n], C[:, :, :n] = moved.B @ excited, seen @ moved.C
    return Slopes(A, B, C, np.zeros((q, len(seen), excited.shape[1])))


def filtered_slopes(after: StateSpace, slopes: Slopes) -> Slopes:
    """Return the slopes of ``after @ S`` from those of S; the filter's states come after those of S."""
    q, n, k = len(slopes.A), slopes.A.shape[1], after.order
    A, B = np.zeros((q, n + k, n + k)), np.zeros((q, n + k, slopes.B.shape[2]))
    C = np.zeros((q, after.outputs, n + k))
    A[:, :n, :n], A[:, n:, :n] = slopes.A, after.B @ slopes.C
    B[:, :n], B[:, n:] = slopes.B, after.B @ slopes.D
    C[:, :, :n] = after.D @ slopes.C
    return Slopes(A, B, C, after.D @ slopes.D)
