"""Residuals of the same colour that do not depend on the inputs.

Two kinds, each right where the other fails. *Signs*: the innovations of an autoregressive model get random signs and are coloured
again (the wild bootstrap); bursts, drifts and changes of level stay. *Phases*: those of the Fourier transform are drawn anew
(J. Theiler et al., Physica D 58, 1992); any power spectrum stays. Both keep the correlation between outputs. Shuffled blocks with
random signs were tried and dropped: on slow noise they called 6 % of controls a gap at a level of 1 %, and added nothing to these two.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator

from afdsvc.explain.gap.autoregression import colour, whiten
from afdsvc.lti.statespace import Array


def surrogates(pieces: Sequence[Array], models: Sequence[Array], count: int, rng: Generator) -> list[Array]:
    """Return per recording ``(n, p, 1 + 2 count)``: the residual, ``count`` surrogates of the first kind, then of the second.

    ``pieces (n, p)`` are the residuals, ``models`` the autoregressive filter of each output.
    """
    made = [np.concatenate([e[:, :, None], _signs(e, models, count, rng), _phases(e, count, rng)], axis=2) for e in pieces]
    return [np.asarray(m - m.mean(0)) for m in made]


def _signs(e: Array, models: Sequence[Array], count: int, rng: Generator) -> Array:
    signs = rng.choice([-1.0, 1.0], size=(len(e), count))
    return np.stack([colour(whiten(x, a)[:, None] * signs, a) for x, a in zip(e.T, models, strict=True)], axis=1)


def _phases(e: Array, count: int, rng: Generator) -> Array:
    spectrum = np.fft.rfft(e, axis=0)
    turned = spectrum[:, :, None] * np.exp(2j * np.pi * rng.uniform(size=(len(spectrum), 1, count)))
    turned[0] = 0.0
    return np.asarray(np.fft.irfft(turned, len(e), axis=0))
