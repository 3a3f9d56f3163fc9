"""The gate every detector stands behind: is the quiet residual what the thresholds were computed for?

The most recent ``window`` quiet samples are kept as a few part sums and tested at the decision. Data pass when the
residual is white, centred and of the stated covariance, or when taking out one fault's share makes it so: a fault
colours the loop's own noise, and that must not silence the detector that is about to name it. At most ``level`` of
the decisions on good data are refused.

The last quiet samples are kept too. Whether one of K faults explains coloured quiet data takes K regressors; computing them for every
sample would make the cost of watching grow with K, so these samples are looked at only when a decision asks: with the shared filter of
all faults, and in detail only with the few faults that are likeliest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import chdtrc

from afdsvc.api.detection import DetectionProblem, ResidualBlock
from afdsvc.detect.features.nuisances import Cleaning, Nuisances
from afdsvc.detect.features.regressors import FaultyResidual, covariance_slopes, faulty_residual
from afdsvc.detect.features.shared_filter import Filters
from afdsvc.detect.features.sums import Products
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


PRECISE = 5e-3  # to which a severity is found that explains quiet data
SWEEPS = 2  # over the severities of two faults, one at a time
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

    def explained(self, gate: Gate, filters: Filters, nuisances: Nuisances, problem: DetectionProblem) -> Judgement | None:
        """Return the judgement that one of the likeliest faults explains these samples, None when none of them does.

        Where psi does not, the machine's own predictor with the fault is tried, and with two of them: a weak sensor shows less of the
        process noise too, which changes gain and covariance of the innovations.
        """
        pieces = list(self._cleaned(filters, nuisances, gate))
        if not pieces:
            return None
        series = np.concatenate(pieces)
        likeliest = _likeliest(series, filters, problem)
        sums = LagSums.empty(gate.lags, len(likeliest), filters.plant.outputs)
        sums = sums.add(_with_regressors(series, filters.theta[likeliest]))
        own = {filters.names[i]: filters.bounds[i] for i in likeliest}
        found = gate.explained(sums, list(own), list(own.values()))
        return found if found is not None or sums.n < gate.needed else self._predicted(gate, own, nuisances, problem)

    def _predicted(self, gate: Gate, own: Mapping[str, tuple[float, float]], nuisances: Nuisances, problem: DetectionProblem) -> Judgement | None:
        """Return the judgement that the predictor of the machine with one or two faults leaves white samples, None when none does.

        Severities are the likeliest ones; the second fault joins the likeliest first. They must gain more than chance does.
        """
        severities: dict[str, float] = {}

        def left(at: Mapping[str, float]) -> tuple[Array, float]:
            return self._left(gate, at, nuisances, problem)

        healthy = left({})[1]
        for _ in range(min(2, len(own))):
            fits = [_likeliest_severity(left, severities, name, bounds) for name, bounds in own.items() if name not in severities]
            _, severities = min(fits, key=lambda fit: fit[0])
            for name in SWEEPS * list(severities) if len(severities) > 1 else ():
                _, severities = _likeliest_severity(left, severities, name, own[name])
            series, cost = left(severities)
            if not np.isfinite(cost) or chdtrc(len(severities), 2 * max(healthy - cost, 0.0)) > gate.level:
                return None
            found = whiteness(LagSums.empty(gate.lags, 0, series.shape[2]).add(series), gate.estimated)
            if found.p >= gate.level:
                return Judgement(True, "", found, "+".join(severities))
        return None

    def _left(self, gate: Gate, severities: Mapping[str, float], nuisances: Nuisances, problem: DetectionProblem) -> tuple[Array, float]:
        """Return the normalised residual ``(n, 1, p)`` under faults and minus its log likelihood, inf without a steady predictor."""
        residual = faulty_residual(problem, severities)
        if residual is None:
            return np.zeros((0, 1, problem.plant.outputs)), np.inf
        series = np.concatenate(list(self._cleaned(residual, nuisances, gate)))
        return series, 0.5 * float(np.sum(series**2)) - len(series) * float(np.sum(np.log(np.diag(residual.Li))))

    def _cleaned(self, filters: Filters | FaultyResidual, nuisances: Nuisances, gate: Gate) -> Iterator[Array]:
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


def _likeliest(series: Array, filters: Filters, problem: DetectionProblem) -> list[int]:
    """Return the faults that gain most likelihood, to second order, at a severity inside its bounds: by what psi takes out of the residual
    and by the covariance that the fault gives it."""
    sums, slopes, e = Products.empty(*filters.theta.shape[1:]).add(series), covariance_slopes(problem), series[:, 0]
    b = sums.score(filters.theta) + 0.5 * np.einsum("kij,ji->k", slopes, e.T @ e - len(e) * np.eye(e.shape[1]))
    G = np.diag(sums.information(filters.theta)) + 0.5 * len(e) * np.einsum("kij,kji->k", slopes, slopes)
    low, high = np.array(filters.bounds).reshape(-1, 2).T
    severity = np.clip(b / np.where(G > 0, G, np.inf), low, high)
    gain = severity * b - severity**2 * G / 2
    return [int(i) for i in np.argsort(-gain, kind="stable")[:LIKELIEST]]


def _likeliest_severity(
    left: Callable[[Mapping[str, float]], tuple[Array, float]], others: Mapping[str, float], name: str, bounds: tuple[float, float],
) -> tuple[float, dict[str, float]]:
    """Return the smallest cost over the severity of one more fault, and all severities there."""
    found = minimize_scalar(lambda theta: left({**others, name: float(theta)})[1], bounds=bounds, method="bounded", options={"xatol": PRECISE})
    return float(found.fun), {**others, name: float(found.x)}


def _with_regressors(series: Array, theta: Array) -> Array:
    """Return residual and regressors ``(n, 1 + K, p)`` for the features in a series."""
    features = series[:, 1:].reshape(len(series), -1)
    return np.concatenate([series[:, :1], np.einsum("kpf,tf->tkp", theta, features)], axis=1)
