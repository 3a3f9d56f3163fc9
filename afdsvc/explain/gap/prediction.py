"""What the flexible model makes of the residual, to be stated and drawn beside a named law."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator

from afdsvc.explain.gap.regression import FeatureRegression, pose
from afdsvc.explain.gap.settings import GapSettings
from afdsvc.explain.gap.signals import Names, ResidualSignals, check_signals
from afdsvc.lti.statespace import Array


def predicted(recordings: Sequence[ResidualSignals], names: Names, rng: Generator, settings: GapSettings) -> list[Array]:
    """Return per recording the residual ``(n, p)`` less its mean, each block predicted by weights not fitted to it."""
    check_signals(recordings, names)
    reg = pose(recordings, names, rng, settings)
    weights = _weights(reg)
    return [reg.centred.scale * _applied(reg, i, weights) for i in range(len(recordings))]


def _weights(reg: FeatureRegression) -> Array:
    """Return the weights of the best tier and ridge parameter of each output ``(folds, features, p)``."""
    products = reg.ridge.products(reg.residual)
    scores = reg.ridge.scores(products)
    out = np.zeros((reg.blocks.folds, reg.ridge.phi.shape[1], reg.residual.shape[1]))
    for j in range(out.shape[2]):
        tier, ridge = scores.choice(j)
        used = reg.ridge.tiers <= tier
        for k in range(len(out)):
            out[k, used, j] = reg.ridge.weights(k, used, ridge, products)[:, j]
    return out / reg.scale[:, None]


def _applied(reg: FeatureRegression, recording: int, weights: Array) -> Array:
    """Return the prediction of one recording at every sample, one feature in memory at a time."""
    signals = reg.recordings[recording]
    fold = reg.blocks.fold_of(recording, np.arange(len(signals)) // reg.step)
    out, at = np.zeros((len(signals), weights.shape[2])), 0
    for feature in reg.dictionary.features:
        for column in reg.dictionary.columns(signals, feature).T:
            out += column[:, None] * weights[fold, at]
            at += 1
    return out
