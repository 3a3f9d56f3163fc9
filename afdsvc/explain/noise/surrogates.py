"""Residuals of the same colour that do not depend on the inputs, and what hypotheses gain on them by chance.

Two kinds, each right where the other fails. *Signs*: the innovations of an autoregressive model get random signs and are coloured
again (the wild bootstrap); bursts, drifts and changes of level stay. *Phases*: those of the Fourier transform are drawn anew
(J. Theiler et al., Physica D 58, 1992); any power spectrum stays. Both keep the correlation between outputs. Shuffled blocks with
random signs were tried and dropped: on slow noise they called 6 % of controls a gap at a level of 1 %, and added nothing to these two.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.fft as sfft
from scipy.signal import lfilter

from afdsvc.lti.statespace import Array


def rephased(residual: Array, rng: np.random.Generator, count: int = 1) -> Array:
    """Return ``count`` residuals ``(n, p, count)`` with the spectra and cross spectra of this one ``(n, p)``, and random phases."""
    spectrum = sfft.rfft(residual - residual.mean(0), axis=0)
    turned = spectrum[:, :, None] * np.exp(2j * np.pi * rng.uniform(size=(len(spectrum), 1, count)))
    turned[0] = 0.0
    return np.asarray(sfft.irfft(turned, len(residual), axis=0))


def drawn(colours: Sequence[Array], lengths: Sequence[int], rng: np.random.Generator) -> list[Array]:
    """Return surrogates of these colours, ``(lengths[k], p)``, repeated where a colour is shorter."""
    return [np.resize(rephased(c, rng)[:, :, 0], (n, c.shape[1])) for c, n in zip(colours, lengths, strict=True)]


def chance(
    colours: Sequence[Array], lengths: Sequence[int], directions: Array, scale: Array, count: int, rng: np.random.Generator,
) -> float:
    """Return the largest fall of the cost along any direction that is expected in ``count`` surrogates of the noise.

    By the extreme-value law with the mean and deviation of their largest falls (E. J. Gumbel, Statistics of Extremes, 1958): the largest that is drawn
    differs by a fifth from one set of surrogates to the next.
    ``colours`` are the noise of every run, or residuals where it is not known; ``lengths`` the samples of every run;
    ``directions (k, rows)`` are what hypotheses change in the scaled residual, ``scale (rows,)`` what residuals are multiplied by.
    """
    norm = directions / np.maximum(np.linalg.norm(directions, axis=1), 1e-300)[:, None]
    made = np.array([np.concatenate([r.ravel() for r in drawn(colours, lengths, rng)]) * scale for _ in range(count)])
    falls = 0.5 * np.max((norm @ made.T) ** 2, axis=0, initial=0.0)
    return float(falls.mean() + np.log(count) * np.sqrt(6) / np.pi * falls.std())


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


def surrogates(pieces: Sequence[Array], models: Sequence[Array], count: int, rng: np.random.Generator) -> list[Array]:
    """Return per recording ``(n, p, 1 + 2 count)``: the residual, ``count`` surrogates of the first kind, then of the second.

    ``pieces (n, p)`` are the residuals, ``models`` the autoregressive filter of each output.
    """
    made = [np.concatenate([e[:, :, None], _signs(e, models, count, rng), rephased(e, rng, count)], axis=2) for e in pieces]
    return [np.asarray(m - m.mean(0)) for m in made]


def _signs(e: Array, models: Sequence[Array], count: int, rng: np.random.Generator) -> Array:
    signs = rng.choice([-1.0, 1.0], size=(len(e), count))
    return np.stack([colour(whiten(x, a)[:, None] * signs, a) for x, a in zip(e.T, models, strict=True)], axis=1)
