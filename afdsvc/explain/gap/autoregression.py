"""Autoregressive models of a residual: its innovations, and the way back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from afdsvc.lti.statespace import Array


def autoregressive(pieces: Sequence[Array], order: int) -> Array:
    """Return the filter ``[1, -a_1, .., -a_order]`` that leaves the innovations of ``pieces``, each ``(n,)``, by least squares.

    Roots outside the unit circle are moved onto it: a residual that drifts keeps drifting, none explodes.
    """
    order = max(1, min(order, max(map(len, pieces)) // 10))
    long = [x for x in pieces if len(x) > order]
    past = np.vstack([np.column_stack([x[order - k : len(x) - k] for k in range(1, order + 1)]) for x in long])
    a = np.concatenate([[1.0], -np.linalg.lstsq(past, np.concatenate([x[order:] for x in long]), rcond=None)[0]])
    size = np.abs(roots := np.roots(a))
    return np.real(np.poly(roots / np.maximum(1.0, size))) if (size > 1).any() else a


def whiten(x: Array, a: Array) -> Array:
    """Return ``x (n, ...)`` through the filter; samples before the first count as zero."""
    return np.asarray(lfilter(a, [1.0], x, axis=0))


def colour(w: Array, a: Array) -> Array:
    """Return the series ``(n, ...)`` whose innovations are ``w``."""
    return np.asarray(lfilter([1.0], a, w, axis=0))
