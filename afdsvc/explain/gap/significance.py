"""How often noise of the residual's own colour is predicted as well as the residual."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.random import Generator

from afdsvc.explain.gap.regression import FeatureRegression, clipped
from afdsvc.explain.gap.ridge import Scores
from afdsvc.explain.gap.settings import GapSettings
from afdsvc.explain.noise.surrogates import autoregressive, surrogates, whiten
from afdsvc.explain.settings import Mapper
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True, eq=False)
class Significance:
    """p-value, scores of the residual's outputs (one column each), and two shares of power per output ``(p,)``.

    ``threshold`` is what surrogates exceed with the stated level, ``whitened`` what is predicted of the innovations.
    """

    p_value: float
    scores: Scores
    threshold: Array
    whitened: Array


def significance(reg: FeatureRegression, count: int, rng: Generator, settings: GapSettings, mapper: Mapper = map) -> Significance:
    """Return how significant the prediction is.

    Two shares of power are compared with those of the surrogates: of the residual (a slow gap under fast noise) and of its
    innovations, features filtered alike (generalised least squares: a fast gap under slow noise). The logarithm of the remaining
    share is scaled by its 50 and 90 % quantiles over residual and surrogates, and the largest over both shares and all outputs is ranked: one p-value for each kind of
    surrogate, the larger counts.
    """
    outputs = range(reg.pieces[0].shape[1])
    models = [autoregressive([e[:, j] for e in reg.pieces], settings.whitening_order) for j in outputs]
    made = surrogates(reg.pieces, models, count, rng)
    as_it_is = partial(_scores, reg, made)
    whitened = [partial(_whitened, reg, [m[:, j] for m in made], models[j], settings) for j in outputs]
    plain, *shares = mapper(lambda regression: regression(), [as_it_is, *whitened])
    white = np.array(shares)
    raw = plain.best().reshape(len(models), -1)
    kinds = [np.r_[0, 1 + k * count : 1 + (k + 1) * count] for k in (0, 1)]
    p_value = max(_rank(np.concatenate([raw[:, k], white[:, k]])) for k in kinds)
    threshold = np.max([np.quantile(raw[:, k[1:]], 1 - settings.level, axis=1) for k in kinds], axis=0)
    own = slice(None, None, 1 + 2 * count)
    return Significance(p_value, Scores(plain.errors[..., own], plain.power[:, own]), threshold, white[:, 0])


def _scores(reg: FeatureRegression, made: list[Array]) -> Scores:
    return reg.ridge.scores(reg.ridge.products(np.concatenate([m.reshape(len(m), -1) for m in made]) * reg.known[:, None]))


def _whitened(reg: FeatureRegression, made: list[Array], a: Array, settings: GapSettings) -> Array:
    E = clipped([whiten(m, a) for m in made], len(a)) * reg.known[:, None]
    ridge = reg.whitened(a, settings)
    return ridge.scores(ridge.products(E)).best()


def _rank(shares: Array) -> float:
    """Return the share of columns whose largest scaled row is at least that of the first column."""
    gain = -np.log(np.maximum(1 - shares, 1e-12))
    middle, high = np.quantile(gain, [0.5, 0.9], axis=1, keepdims=True)
    largest = ((gain - middle) / np.where(high > middle, high - middle, 1.0)).max(0)
    return float((largest >= largest[0]).mean())
