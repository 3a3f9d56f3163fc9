"""The last quiet samples of a machine, looked at again only when they need an explanation.

A fault colours the loop's own noise. Whether one of K faults explains coloured quiet data takes K regressors; computing them
for every sample would make the cost of watching grow with K, so they are computed from the samples kept when a decision asks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from afdsvc.api.detection import ResidualBlock
from afdsvc.detect.nuisances import Cleaning, Nuisances
from afdsvc.detect.regressors import Regressors
from afdsvc.detect.whiteness import LagSums


@dataclass(frozen=True, slots=True)
class Recent:
    """Quiet blocks, oldest first, ``n`` samples in all: the newest of them, however they were cut."""

    blocks: tuple[ResidualBlock, ...] = ()
    n: int = 0

    def add(self, block: ResidualBlock, most: int) -> Recent:
        """Return the samples with a block added, the oldest beyond ``most`` forgotten."""
        blocks, n = (*self.blocks, block), self.n + len(block)
        while blocks and n - len(blocks[0]) >= most:
            n -= len(blocks[0])
            blocks = blocks[1:]
        if n > most:
            blocks = (_from(blocks[0], n - most), *blocks[1:])
        return Recent(blocks, min(n, most))

    def sums(self, filters: Regressors, nuisances: Nuisances, lags: int, settle: int, period: int) -> LagSums:
        """Return lagged products of residual and regressors; ``settle`` samples are left out after every interruption."""
        sums = LagSums.empty(lags, len(filters.names), filters.plant.outputs)
        cleaning: Cleaning | None = None
        state, left, expected = filters.start(), settle, -1
        for block in self.blocks:
            if block.k0 != expected:
                state, cleaning, left = filters.start(), None, settle
            expected = block.k0 + len(block)
            state, series = filters.step(state, block.r, block.y, block.u)
            skipped = min(left, len(block))
            left -= skipped
            if skipped < len(block):
                cleaning, clean, kept = nuisances.clean(cleaning, _from(block, skipped), series[skipped:], period)
                sums = sums.add(clean[kept])
        return sums


NOTHING = Recent()


def _from(block: ResidualBlock, first: int) -> ResidualBlock:
    """Return a block without its first samples."""
    aux = {label: values[first:] for label, values in block.aux.items()}
    r, beta, u, y, alpha = (a[first:] for a in (block.r, block.beta, block.u, block.y, block.alpha))
    return replace(block, k0=block.k0 + first, r=r, beta=beta, u=u, y=y, alpha=alpha, aux=aux)
