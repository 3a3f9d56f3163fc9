"""Residual and features side by side: what the test, its attribution and the prediction are computed from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from afdsvc.errors import BadInput
from afdsvc.explain.gap.blocks import Blocks, bartlett_time, contiguous_blocks
from afdsvc.explain.gap.dictionary import dictionary
from afdsvc.explain.gap.features import Dictionary, Groups
from afdsvc.explain.gap.ridge import Ridge
from afdsvc.explain.gap.settings import GapSettings
from afdsvc.explain.gap.signals import Centred, Names, ResidualSignals, centred
from afdsvc.explain.noise.surrogates import whiten
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True, eq=False)
class FeatureRegression:
    """Rows are every ``step``-th sample of every recording.

    Attributes
    ----------
    pieces : list of (rows, p)
        Residuals of unit power per output, missing readings interpolated.
    known : (rows,)
        1 where every output was read, else 0: such rows count for nothing.
    scale : (features,)
        Standard deviation of each feature.
    tau : (p,)
        Correlation time of the residual [samples].
    """

    recordings: Sequence[ResidualSignals]
    centred: Centred
    dictionary: Dictionary
    groups: list[Groups]
    ridge: Ridge
    blocks: Blocks
    pieces: list[Array]
    known: Array
    scale: Array
    step: int
    tau: Array

    @property
    def residual(self) -> Array:
        """Residual of all rows, zero where a reading is missing ``(rows, p)``."""
        return np.asarray(np.concatenate(self.pieces) * self.known[:, None])

    def whitened(self, a: Array, settings: GapSettings) -> Ridge:
        """Return the regression of innovations: features through the autoregressive filter ``a``, see `clipped`."""
        cuts = np.cumsum([len(e) for e in self.pieces])[:-1]
        phi = clipped([whiten(x, a) for x in np.split(self.ridge.phi, cuts)], len(a))
        sd = phi.std(0)
        return Ridge(phi / np.where(sd > 0, sd, 1.0), self.ridge.tiers, self.blocks, settings)

    @property
    def correlations(self) -> Array:
        """Number of correlation times in all recordings, per output ``(p,)``."""
        return np.asarray(sum(map(len, self.recordings)) / self.tau)


def pose(recordings: Sequence[ResidualSignals], names: Names, rng: Generator, settings: GapSettings) -> FeatureRegression:
    """Return the regression of these recordings; ``names`` are those of outputs, inputs, states, aux."""
    residuals = centred(recordings)
    E = residuals.pieces
    step = max(1, -(-sum(map(len, recordings)) // settings.rows))
    tau = bartlett_time(E, settings.lag_share)
    thin = [e[::step] for e in E]
    known = np.concatenate([np.isfinite(e).all(1) for e in thin]).astype(float)
    found = dictionary(recordings, names, rng, settings)
    phi, groups, tiers = _features(recordings, found, step)
    scale = np.where((s := phi.std(0)) > 0, s, 1.0)
    cut = contiguous_blocks([len(e) for e in thin], max(1.0, float(tau.max()) / step), settings)
    ridge = Ridge(phi / scale * known[:, None], tiers, cut, settings)
    return FeatureRegression(recordings, residuals, found, groups, ridge, cut, [_filled(e) for e in thin], known, scale, step, tau)


def clipped(pieces: Sequence[Array], samples: int) -> Array:
    """Return the pieces one below the other, the first ``samples`` rows of each zero: there a filter has not settled."""
    out = [x.copy() for x in pieces]
    for x in out:
        x[:samples] = 0.0
    return np.concatenate(out)


def _features(recordings: Sequence[ResidualSignals], found: Dictionary, step: int) -> tuple[Array, list[Groups], Array]:
    """Return the thinned features ``(rows, features)``, the groups and the tier of each column; one column in full at a time."""
    columns = [np.concatenate([found.columns(r, f)[::step] for r in recordings]) for f in found.features]
    groups = [f.groups for f, c in zip(found.features, columns, strict=True) for _ in range(c.shape[1])]
    tiers = [f.tier for f, c in zip(found.features, columns, strict=True) for _ in range(c.shape[1])]
    return np.hstack(columns), groups, np.array(tiers)


def _filled(e: Array) -> Array:
    """Return ``e (n, p)`` with missing readings interpolated, zero where a recording has none."""
    out, at = e.copy(), np.arange(len(e))
    for x in out.T:
        known = np.isfinite(x)
        x[~known] = np.interp(at[~known], at[known], x[known]) if known.any() else 0.0
    return out


def predicted(recordings: Sequence[ResidualSignals], names: Names, rng: Generator, settings: GapSettings) -> list[Array]:
    """Return per recording the residual ``(n, p)`` less its mean, each block predicted by weights not fitted to it."""
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
