"""What the flexible model makes of the residual, to be stated and drawn beside a named law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from afdsvc.errors import BadInput
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


def projected(recordings: Sequence[ResidualSignals], rng: Generator, settings: GapSettings) -> Sequence[ResidualSignals]:
    """Return the recordings with inputs and states replaced by what the references predict of them; as they are without one.

    In a closed loop the controller feeds the noise of the outputs into the inputs, and so into a simulation from measured inputs: past
    noise would predict the residual of a perfect model. What a signal from outside the loop predicts of them holds no noise (the
    first stage of two-stage least squares; L. Ljung, System Identification, 2nd ed., section 13.5). Each block is predicted by weights
    not fitted to it, or a part of its own noise would come back.
    """
    given = [r.reference for r in recordings if r.reference is not None]
    if not given:
        return recordings
    if len(given) < len(recordings):
        raise BadInput(f"gap test: {len(given)} of {len(recordings)} recordings have a reference; expected one in all or in none")
    targets = [np.hstack([r.inputs, r.states]) for r in recordings]
    posed = [ResidualSignals(t, g, t[:, :0], t[:, :0], r.dt) for t, g, r in zip(targets, given, recordings, strict=True)]
    names: list[list[str]] = [[f"signal {i}" for i in range(targets[0].shape[1])], [f"reference {i}" for i in range(given[0].shape[1])], [], []]
    found = [t.mean(0) + f for t, f in zip(targets, predicted(posed, names, rng, settings), strict=True)]
    parts = [np.split(f, [r.inputs.shape[1]], axis=1) for r, f in zip(recordings, found, strict=True)]
    return [replace(r, inputs=u, states=x) for r, (u, x) in zip(recordings, parts, strict=True)]
