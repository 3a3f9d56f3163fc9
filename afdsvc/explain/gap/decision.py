"""Is there a gap between simulation and recording, and how large? Asked before any library of physics is consulted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.random import Generator

from afdsvc.explain.gap.finding import Gap, sentence
from afdsvc.explain.gap.regression import FeatureRegression, clipped, pose, predicted, projected
from afdsvc.explain.gap.repeating import repeating_share
from afdsvc.explain.gap.ridge import CrossProducts, Scores
from afdsvc.explain.gap.settings import GapSettings
from afdsvc.explain.gap.signals import ResidualSignals, check_signals
from afdsvc.explain.noise.surrogates import autoregressive, surrogates, whiten
from afdsvc.explain.settings import Mapper
from afdsvc.lti.statespace import Array


def gap_test(
    recordings: Sequence[ResidualSignals], state_names: Sequence[str], input_names: Sequence[str], output_names: Sequence[str],
    aux_names: Sequence[str], rng: Generator, surrogates: int = 99, settings: GapSettings | None = None, mapper: Mapper = map,
) -> Gap:
    """Return whether the residual depends on inputs, simulated states, aux or time, or repeats with them, and what share of it.

    Parameters
    ----------
    recordings : sequence of Signals
        Residuals of the simulation with what drove it.
    state_names, input_names, output_names, aux_names : sequence of str
        Names of the columns, the same for all recordings.
    rng : Generator
        Draws the random features and the surrogates.
    surrogates : int
        Surrogates of each kind; the smallest p-value is ``1 / (surrogates + 1)``.
    mapper : callable
        `map`, or what does the same in several threads.

    Raises
    ------
    BadInput
        Columns that do not match their names, or numbers that are not finite.
    """
    settings = settings or GapSettings()
    names = (output_names, input_names, state_names, aux_names)
    check_signals(recordings, names)
    reg = pose(projected(recordings, rng, settings), names, rng, settings)
    sure = significance(reg, surrogates, rng, settings, mapper)
    again = repeating_share(recordings, reg.centred.pieces, settings)
    p_value = sure.p_value if again is None else min(1.0, 2 * min(sure.p_value, again.p_value))
    r2 = sure.scores.best()
    choices = [sure.scores.choice(j) for j in range(len(r2))]
    held = float(reg.correlations.max()) / settings.block_times
    won = sum(sure.scores.errors[tier, :, ridge, j] for j, (tier, ridge) in enumerate(choices)) < sure.scores.power.sum(1)
    found = Gap(
        present=p_value <= settings.level, r2=_floats(r2), total=float(r2.mean()), linear=float(sure.scores.r2()[0].max(0).mean()),
        whitened=_floats(sure.whitened), p_value=p_value, threshold=_floats(sure.threshold), blocks=reg.blocks.folds,
        blocks_won=float(np.mean(won)), enough=held >= settings.needed_blocks, correlation_time=_floats(reg.tau),
        depends_on=depends_on(reg, choices, r2), repeats=None if again is None else _floats(again.share), offset=_floats(reg.centred.offset),
    )
    return replace(found, sentence=sentence(found, output_names, held, settings.needed_blocks))


def flexible_prediction(
    recordings: Sequence[ResidualSignals], state_names: Sequence[str], input_names: Sequence[str], output_names: Sequence[str],
    aux_names: Sequence[str], rng: Generator, settings: GapSettings | None = None,
) -> list[Array]:
    """Return per recording the residual ``(n, p)`` that the model of `gap` predicts, each block by weights not fitted to it.

    In the unit of the outputs, without the constant of each recording, at every sample (also where a reading is missing).
    ``1 - |residual - mean - prediction|^2 / |residual - mean|^2`` over all recordings is `Gap.r2`, but for thinning of long ones.
    """
    settings = settings or GapSettings()
    names = (output_names, input_names, state_names, aux_names)
    check_signals(recordings, names)
    return predicted(projected(recordings, rng, settings), names, rng, settings)


def depends_on(reg: FeatureRegression, choices: Sequence[tuple[int, int]], r2: Array) -> tuple[tuple[str, float], ...]:
    """Return the share of power lost without each group of features, mean over outputs, largest first."""
    products = reg.ridge.products(reg.residual)
    lost = [(g, float(np.mean(r2 - _without(reg, g, choices, products)))) for g in sorted(frozenset().union(*reg.groups))]
    return tuple(sorted(lost, key=lambda pair: -pair[1]))


def _without(reg: FeatureRegression, group: str, choices: Sequence[tuple[int, int]], products: CrossProducts) -> Array:
    """Return the share per output that is predicted without a group, at least none."""
    free = np.array([group not in g for g in reg.groups])
    shares = {c: reg.ridge.share(free & (reg.ridge.tiers <= c[0]), c[1], products) for c in set(choices)}
    return np.array([max(0.0, shares[c][j]) for j, c in enumerate(choices)])


def _floats(x: Array) -> tuple[float, ...]:
    return tuple(float(v) for v in x)


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
