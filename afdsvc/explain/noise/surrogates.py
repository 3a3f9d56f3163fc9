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


def drawn(colours: Sequence[Array], lengths: Sequence[int], rng: np.random.Generator) -> list[Array]:
    """Return surrogates of these colours, ``(lengths[k], p)``, repeated where a colour is shorter."""
    return [np.resize(rephased(c, rng), (n, c.shape[1])) for c, n in zip(colours, lengths, strict=True)]


def chance(
    colours: Sequence[Array], lengths: Sequence[int], directions: Array, scale: Array, count: int, rng: np.random.Generator,
) -> Array:
    """Return the largest fall of the cost along any direction for ``count`` surrogates of the noise, ``(count,)``.

    ``colours`` are the noise of every run, or residuals where it is not known; ``lengths`` the samples of every run;
    ``directions (k, rows)`` are what hypotheses change in the scaled residual, ``scale (rows,)`` what residuals are multiplied by.
    """
    norm = directions / np.maximum(np.linalg.norm(directions, axis=1), 1e-300)[:, None]
    found = np.empty(count)
    for i in range(count):
        e = np.concatenate([r.ravel() for r in drawn(colours, lengths, rng)]) * scale
        found[i] = 0.5 * float(np.max((norm @ e) ** 2, initial=0.0))
    return found
