"""A transition matrix that is stable by construction."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from afdsvc.lti.statespace import Array

#: Largest modulus of a pole that the guarantee leaves.
LIMIT = 0.9999


def stable_transition(Gamma: Array, outputs: int, limit: float = LIMIT) -> Array:
    """Return A with spectral radius at most ``limit`` from an observability matrix ``Gamma (s p, n)``.

    The least-squares solution of ``Gamma[:-p] A = Gamma[p:]`` is kept when it is stable; otherwise the smallest ridge c
    in ``A = (G'G + c I)^-1 G' Gamma[p:]`` that makes it so is found by bisection (Van Gestel, Suykens, Van Dooren and
    De Moor, 2001). The modulus falls continuously to 0 as c grows, so a solution always exists.
    """
    before, after = Gamma[:-outputs], Gamma[outputs:]
    plain = linalg.lstsq(before, after)[0]
    if _radius(plain) <= limit:
        return np.asarray(plain)
    square, cross = before.T @ before, before.T @ after
    size = float(np.trace(square)) / len(square)

    def ridge(log_c: float) -> Array:
        return np.asarray(linalg.solve(square + size * 10.0**log_c * np.eye(len(square)), cross, assume_a="pos"))

    low, high = -16.0, 6.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if _radius(ridge(middle)) <= limit else (middle, high)
    return ridge(high)


def _radius(A: Array) -> float:
    return float(np.abs(np.linalg.eigvals(A)).max())
