"""A window of the last samples without a burst, evaluated only when their whiteness has to be explained.

A fault colours the loop's own noise. Whether one of K faults explains coloured quiet data takes K regressors; computing them
for every sample would make the cost of watching grow with K, so the samples kept are looked at when a decision asks: with the
shared filter of all faults, and in detail only with the few faults that are likeliest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from afdsvc.api.detection import ResidualBlock
from afdsvc.detect.features.nuisances import Cleaning, Nuisances
from afdsvc.detect.features.shared_filter import Filters
from afdsvc.detect.features.sums import Products
from afdsvc.detect.features.whiteness_gate import Gate, Judgement
from afdsvc.lti.statespace import Array
from afdsvc.stats.whiteness import LagSums

LIKELIEST = 3  # faults that may explain coloured data: those that explain most of them


@dataclass(frozen=True, slots=True)
class Recent:
    """Quiet blocks, oldest first, ``n`` samples in all: the newest of them, however they were cut."""

    blocks: tuple[ResidualBlock, ...] = ()
    n: int = 0

    def add(self, block: ResidualBlock, most: int) -> Recent:
        """Return the samples with a block added, the oldest beyond ``most`` forgotten."""
        return _newest((*self.blocks, block), self.n + len(block), most)

    def until(self, k: int, most: int) -> Recent:
        """Return the newest ``most`` samples up to and with sample ``k``."""
        blocks = tuple(between(b, 0, k + 1 - b.k0) for b in self.blocks if b.k0 <= k)
        return _newest(blocks, sum(len(b) for b in blocks), most)

    def explained(self, gate: Gate, filters: Filters, nuisances: Nuisances) -> Judgement | None:
        """Return the judgement that one of the likeliest faults explains these samples, None when none of them does."""
        pieces = list(self._cleaned(filters, nuisances, gate))
        if not pieces:
            return None
        series = np.concatenate(pieces)
        likeliest = _likeliest(series, filters)
        sums = LagSums.empty(gate.lags, len(likeliest), filters.plant.outputs)
        sums = sums.add(_with_regressors(series, filters.theta[likeliest]))
        return gate.explained(sums, [filters.names[i] for i in likeliest], [filters.bounds[i] for i in likeliest])

    def _cleaned(self, filters: Filters, nuisances: Nuisances, gate: Gate) -> Iterator[Array]:
        """Yield series without nuisances; ``settle`` samples are left out after every interruption."""
        cleaning: Cleaning | None = None
        state: Any
        state, left, expected = filters.start(), gate.settle, -1
        for block in self.blocks:
            if block.k0 != expected:
                state, cleaning, left = filters.start(), None, gate.settle
            expected = block.k0 + len(block)
            state, series = filters.step(state, block.r, block.y, block.u)
            skipped = min(left, len(block))
            left -= skipped
            if skipped < len(block):
                cleaning, clean, kept = nuisances.clean(cleaning, between(block, skipped, len(block)), series[skipped:], gate.part)
                yield clean[kept]


NOTHING = Recent()


def _newest(blocks: tuple[ResidualBlock, ...], n: int, most: int) -> Recent:
    while blocks and n - len(blocks[0]) >= most:
        n -= len(blocks[0])
        blocks = blocks[1:]
    if n > most:
        blocks = (between(blocks[0], n - most, len(blocks[0])), *blocks[1:])
    return Recent(blocks, min(n, most))


def between(block: ResidualBlock, first: int, end: int) -> ResidualBlock:
    """Return the samples of a block from ``first`` to before ``end``."""
    aux = {label: values[first:end] for label, values in block.aux.items()}
    r, beta, u, y, alpha = (a[first:end] for a in (block.r, block.beta, block.u, block.y, block.alpha))
    return replace(block, k0=block.k0 + first, r=r, beta=beta, u=u, y=y, alpha=alpha, aux=aux)


def _likeliest(series: Array, filters: Filters) -> list[int]:
    """Return the faults whose severity, inside its bounds, takes most out of the residual."""
    sums = Products.empty(*filters.theta.shape[1:]).add(series)
    b, G = sums.score(filters.theta), np.diag(sums.information(filters.theta))
    low, high = np.array(filters.bounds).reshape(-1, 2).T
    severity = np.clip(b / np.where(G > 0, G, np.inf), low, high)
    gain = severity * b - severity**2 * G / 2
    return [int(i) for i in np.argsort(-gain, kind="stable")[:LIKELIEST]]


def _with_regressors(series: Array, theta: Array) -> Array:
    """Return residual and regressors ``(n, 1 + K, p)`` for the features in a series."""
    features = series[:, 1:].reshape(len(series), -1)
    return np.concatenate([series[:, :1], np.einsum("kpf,tf->tkp", theta, features)], axis=1)
