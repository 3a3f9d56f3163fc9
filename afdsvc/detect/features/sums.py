"""Running sums of products shared by all hypotheses: ``sum e f'`` and ``sum f f'`` of a residual e and features f.

When hypothesis i expects ``theta_i f[k]`` per unit of its severity, its score is ``sum (theta_i f)' e`` and the
information of two of them ``sum (theta_i f)' theta_j f``: both follow from these sums for any number of hypotheses.
Sums of squares are kept packed, upper triangle row by row.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True, eq=False)
class Products:
    """``cross (p, F)`` and packed ``square (F (F + 1) / 2,)`` over ``n`` samples."""

    n: int
    cross: Array
    square: Array

    @classmethod
    def empty(cls, outputs: int, features: int) -> Products:
        """Return sums over nothing."""
        return cls(0, np.zeros((outputs, features)), np.zeros(features * (features + 1) // 2))

    def add(self, series: Array) -> Products:
        """Return the sums with samples added; ``series (n, S, p)``: the residual, then features as vectors of p.

        Raises `BadInput` when the series holds other features than the sums do.
        """
        cross, square = self.cross.copy(), self.square.copy()
        flat = np.ascontiguousarray(series).reshape(len(series), -1)
        if flat.shape[1] != sum(cross.shape):
            raise BadInput(f"series of {flat.shape[1]} columns; expected {cross.shape[0]} of the residual and {cross.shape[1]} features")
        _accumulate(flat, cross, square)
        return Products(self.n + len(series), cross, square)

    def score(self, theta: Array) -> Array:
        """Return the scores of the hypotheses ``theta (K, p, F)``, shape ``(K,)``."""
        return np.asarray(np.einsum("kpf,pf->k", theta, self.cross))

    def information(self, theta: Array) -> Array:
        """Return the information of the hypotheses about their severities, shape ``(K, K)``."""
        F = theta.shape[2]
        full = np.zeros((F, F))
        full[np.triu_indices(F)] = self.square
        full += np.triu(full, 1).T
        rows = np.moveaxis(theta, 1, 0)
        return np.asarray(np.sum(rows @ full @ np.swapaxes(rows, 1, 2), axis=0))


def selection(hypotheses: int, outputs: int) -> Array:
    """Return theta ``(K, p, K p)`` when the features are the regressors themselves, one after the other."""
    return np.eye(hypotheses * outputs).reshape(hypotheses, outputs, hypotheses * outputs)


@njit(cache=True)
def _accumulate(flat, cross, square):  # type: ignore[no-untyped-def]
    p = cross.shape[0]
    for t in range(flat.shape[0]):
        add_products(flat[t, :p], flat[t, p:], cross, square)


@njit(cache=True)
def add_products(e, f, cross, square):  # type: ignore[no-untyped-def]
    """Add the products of one sample; the inner loops run along memory, always in the same order."""
    F, at = f.size, 0
    for q in range(e.size):
        v = e[q]
        for j in range(F):
            cross[q, j] += v * f[j]
    for i in range(F):
        v = f[i]
        row = square[at : at + F - i]
        tail = f[i:]
        for j in range(F - i):
            row[j] += v * tail[j]
        at += F - i
