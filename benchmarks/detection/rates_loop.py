"""Steps of a compiled loop: states, waves, likelihood ratios."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, fastmath=True, inline="always")
def advance(A, x, new):  # type: ignore[no-untyped-def]
    """Write ``A x`` to ``new``."""
    n = x.size
    for i in range(n):
        s = 0.0
        for j in range(n):
            s += A[i, j] * x[j]
        new[i] = s


@njit(cache=True, fastmath=True, inline="always")
def drive(B, signal, out):  # type: ignore[no-untyped-def]
    """Add ``B signal`` to ``out``."""
    for i in range(out.size):
        for q in range(signal.size):
            out[i] += B[i, q] * signal[q]


@njit(cache=True, fastmath=True, inline="always")
def read(C, x, psi):  # type: ignore[no-untyped-def]
    """Write ``C x`` to the rows of ``psi (K, p)``."""
    K, p = psi.shape
    for i in range(K):
        for q in range(p):
            s = 0.0
            for j in range(x.size):
                s += C[i * p + q, j] * x[j]
            psi[i, q] = s


@njit(cache=True, fastmath=True, inline="always")
def gain(waves, e, gained, shiryaev):  # type: ignore[no-untyped-def]
    """Add the log likelihood ratios of the waves ``(K, p)`` in one residual, and take Shiryaev's step."""
    K, p = waves.shape
    for i in range(K):
        ratio = 0.0
        for q in range(p):
            ratio += waves[i, q] * e[q] - 0.5 * waves[i, q] ** 2
        gained[i] += ratio
        shiryaev[i] = (1.0 + shiryaev[i]) * np.exp(ratio)


@njit(cache=True, inline="always")
def reflect(g, gained):  # type: ignore[no-untyped-def]
    """Add what was gained, reflect at zero, begin anew."""
    for i in range(g.size):
        g[i] = max(g[i] + gained[i], 0.0)
        gained[i] = 0.0
