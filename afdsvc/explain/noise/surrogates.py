"""What chance reaches: the largest gain of any hypothesis on residuals of the same colour that have nothing to do with the inputs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.fft as sfft

from afdsvc.lti.statespace import Array


def rephased(residual: Array, rng: np.random.Generator) -> Array:
    """Return a residual ``(n, p)`` with its own power spectra and cross spectra, and random phases (Theiler 1992)."""
    spectrum = sfft.rfft(residual - residual.mean(0), axis=0)
    turned = spectrum * np.exp(2j * np.pi * rng.uniform(size=(len(spectrum), 1)))
    turned[0] = 0.0
    return np.asarray(sfft.irfft(turned, len(residual), axis=0))


def chance(residuals: Sequence[Array], directions: Array, scale: Array, count: int, rng: np.random.Generator) -> Array:
    """Return the largest fall of the cost along any direction for ``count`` surrogates of the residuals, ``(count,)``.

    ``directions (k, rows)`` are what hypotheses change in the scaled residual, ``scale (rows,)`` what residuals are multiplied by.
    """
    norm = directions / np.maximum(np.linalg.norm(directions, axis=1), 1e-300)[:, None]
    found = np.empty(count)
    for i in range(count):
        e = np.concatenate([rephased(r, rng).ravel() for r in residuals]) * scale
        found[i] = 0.5 * float(np.max((norm @ e) ** 2, initial=0.0))
    return found
