"""Ridge regression cross-validated over left-out folds, for many residuals at once.

Only Gram matrices are kept: with ``G_k = Phi_k' Phi_k`` and ``b_k = Phi_k' e_k`` of fold k, the weights fitted without it are
``w = (sum_{j != k} G_j + lambda n I)^-1 sum_{j != k} b_j`` and its squared error is ``e_k' e_k - 2 b_k' w + w' G_k w``. A surrogate
residual changes the ``b_k`` only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from afdsvc.explain.gap.blocks import Blocks
from afdsvc.explain.gap.settings import GapSettings
from afdsvc.lti.statespace import Array

BoolArray = np.typing.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class CrossProducts:
    """Per fold: products of features and residuals in it and in what is fitted without it ``(features, columns)``, power ``(columns,)``."""

    own: list[Array]
    fitted: list[Array]
    power: Array


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """Squared errors ``(tiers, folds, ridges, columns)`` of left-out folds, and their power ``(folds, columns)``."""

    errors: Array
    power: Array

    def r2(self) -> Array:
        """Return the share of power predicted ``(tiers, ridges, columns)``, 0 where there is no power."""
        power = self.power.sum(0)
        return np.asarray(np.where(power > 0, 1 - self.errors.sum(1) / np.where(power > 0, power, 1.0), 0.0))

    def best(self) -> Array:
        """Return the share of power that the best tier and ridge parameter predict, per column."""
        return np.asarray(self.r2().max((0, 1)))

    def choice(self, column: int) -> tuple[int, int]:
        """Return tier and index of the ridge parameter that predict a column best."""
        r2 = self.r2()[:, :, column]
        tier, ridge = np.unravel_index(int(r2.argmax()), r2.shape)
        return int(tier), int(ridge)


class Ridge:
    """Ridge regression on ``phi (rows, features)``, columns of unit variance; ``tiers (features,)`` is the first tier that uses each."""

    def __init__(self, phi: Array, tiers: Array, blocks: Blocks, settings: GapSettings) -> None:
        self.phi, self.tiers = phi, tiers
        low, high, count = settings.ridge
        self.ridges = len(phi) * np.geomspace(low, high, count)
        self.rows = [blocks.rows(k) for k in range(blocks.folds)]
        self.beside = [blocks.neighbours(k) for k in range(blocks.folds)]
        self.gram = [phi[r].T @ phi[r] for r in self.rows]
        whole = np.sum(self.gram, axis=0)
        self.fitted = [whole - g - phi[r].T @ phi[r] for g, r in zip(self.gram, self.beside, strict=True)]

    def products(self, E: Array) -> CrossProducts:
        """Return the products with residuals ``E (rows, columns)``."""
        own = [self.phi[r].T @ E[r] for r in self.rows]
        whole = np.sum(own, axis=0)
        fitted = [whole - b - self.phi[r].T @ E[r] for b, r in zip(own, self.beside, strict=True)]
        return CrossProducts(own, fitted, np.array([(E[r] ** 2).sum(0) for r in self.rows]))

    def scores(self, products: CrossProducts) -> Scores:
        """Return the errors of each residual in every left-out fold, for each tier and ridge parameter."""
        used = [self.tiers <= tier for tier in np.unique(self.tiers)]
        errors = [[self._fold(k, u, products) for k in range(len(self.rows))] for u in used]
        return Scores(np.array(errors), products.power)

    def _fold(self, k: int, used: BoolArray, products: CrossProducts) -> Array:
        pick = np.ix_(used, used)
        values, V = np.linalg.eigh(self.fitted[k][pick])
        turned, fitted, own = V.T @ self.gram[k][pick] @ V, V.T @ products.fitted[k][used], V.T @ products.own[k][used]
        weights = [fitted / (np.maximum(values, 0.0) + ridge)[:, None] for ridge in self.ridges]
        return np.array([products.power[k] - 2 * (own * w).sum(0) + (w * (turned @ w)).sum(0) for w in weights])

    def weights(self, k: int, used: BoolArray, ridge: int, products: CrossProducts) -> Array:
        """Return the weights ``(features used, columns)`` fitted without fold ``k``."""
        A = self.fitted[k][np.ix_(used, used)] + self.ridges[ridge] * np.eye(int(used.sum()))
        return np.asarray(cho_solve(cho_factor(A), products.fitted[k][used]))

    def share(self, used: BoolArray, ridge: int, products: CrossProducts) -> Array:
        """Return the share of power predicted in left-out folds from the features used, per column."""
        error = np.zeros(products.power.shape[1])
        for k, G in enumerate(self.gram):
            w = self.weights(k, used, ridge, products)
            error += products.power[k] - 2 * (products.own[k][used] * w).sum(0) + (w * (G[np.ix_(used, used)] @ w)).sum(0)
        power = products.power.sum(0)
        return np.asarray(np.where(power > 0, 1 - error / np.where(power > 0, power, 1.0), 0.0))
