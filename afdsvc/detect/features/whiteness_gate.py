"""The gate every detector stands behind: is the quiet residual what the thresholds were computed for?

The most recent ``window`` quiet samples are kept as a few part sums and tested at the decision. Data pass when the
residual is white, centred and of the stated covariance, or when taking out one fault's share makes it so: a fault
colours the loop's own noise, and that must not silence the detector that is about to name it. At most ``level`` of
the decisions on good data are refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from afdsvc.lti.statespace import Array
from afdsvc.stats.whiteness import LagSums, Whiteness, whiteness, whiteness_without

PARTS = 4


@dataclass(frozen=True, slots=True)
class Gate:
    """Settings: share of good data refused, lags, quiet samples remembered, samples to wait after a start or gap, and samples the
    noise was ``estimated`` from (0: stated)."""

    level: float = 1e-3
    lags: int = 20
    window: int = 2500
    settle: int = 0
    estimated: int = 0

    @property
    def needed(self) -> int:
        """Quiet samples without which nothing is trusted."""
        return max(self.window // PARTS, 10 * self.lags)

    def start(self, faults: int, outputs: int, because: str = "the start") -> GateState:
        """Return the state before any sample."""
        return GateState(LagSums.empty(self.lags, faults, outputs), (), self.settle, because)

    def restart(self, state: GateState, because: str) -> GateState:
        """Return the state after a gap or a sample that cannot be used."""
        return self.start(state.now.cross.shape[1], state.now.residual.shape[1], because)

    def add(self, state: GateState, series: Array) -> GateState:
        """Return the state with the quiet samples ``series (n, 1 + K, p)`` added; K + 1 normalised series as in
        LagSums.
        """
        skipped = min(state.skip, len(series))
        if skipped:
            state, series = replace(state, skip=state.skip - skipped), series[skipped:]
        while len(series):
            room = self.part - state.now.n
            now = state.now.add(series[:room] if room < len(series) else series)
            series = series[room:]
            parts = state.parts
            if now.n >= self.part:
                parts, now = (*parts, now)[-PARTS:], now.cleared()
            state = GateState(now, parts, state.skip, state.because)
        return state

    @property
    def part(self) -> int:
        """Samples in one part sum."""
        return max(1, -(-self.window // PARTS))

    def judge(self, state: GateState, level: float | None = None) -> Judgement:
        """Return whether the quiet data can be trusted as they are, and if not, why; at another ``level`` where one is given."""
        level = self.level if level is None else level
        sums = state.sums()
        if sums.n < self.needed:
            return Judgement(
                False,
                f"only {sums.n} quiet samples since {state.because}; expected {self.needed} to trust a decision",
            )
        plain = whiteness(sums, self.estimated)
        return Judgement(plain.p >= level, plain.reason(level), plain)

    def explained(
        self, sums: LagSums, names: Sequence[str], bounds: Sequence[tuple[float, float]]
    ) -> Judgement | None:
        """Return the judgement that one of the faults explains the data, None when none does.

        ``names`` are the faults and uncertain parameters of the sums, ``bounds`` the values they may have.
        """
        if sums.n < self.needed:
            return None
        for i, (name, (low, high)) in enumerate(zip(names, bounds, strict=True)):
            theta = min(max(sums.severity(i)[0], low), high)
            explained = whiteness_without(sums, i, theta, self.estimated)
            if theta and explained.p >= self.level:
                return Judgement(True, "", explained, name)
        return None


@dataclass(frozen=True, slots=True)
class GateState:
    """Part sums: the one being filled, the last full ones, samples still to skip, and what happened last."""

    now: LagSums
    parts: tuple[LagSums, ...]
    skip: int
    because: str

    def sums(self) -> LagSums:
        """Return the sums over everything remembered."""
        total = self.now
        for part in reversed(self.parts):
            total = part + total
        return total


@dataclass(frozen=True, slots=True)
class Judgement:
    """Whether quiet data can be trusted; ``reason`` is a sentence when not, ``explained_by`` the fault that whitens
    them.
    """

    ok: bool
    reason: str
    found: Whiteness | None = None
    explained_by: str = ""
    notes: tuple[str, ...] = field(default=())

    @property
    def p_white(self) -> float | None:
        """p-value of the whiteness test; None before there are enough samples."""
        return None if self.found is None else self.found.p


def finite(*arrays: Array) -> bool:
    """Whether all samples are finite."""
    return all(bool(np.isfinite(a).all()) for a in arrays)
