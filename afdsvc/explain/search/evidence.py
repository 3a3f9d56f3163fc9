"""What speaks for a hypothesis: gain of likelihood, share of the gap on left-out blocks, agreement of the blocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from afdsvc.explain.search.fit import Coordinates, Fit, weighted
from afdsvc.explain.search.problem import Problem
from afdsvc.explain.settings import Settings
from afdsvc.lti.statespace import Array

LONGEST_STEP = 3.0  # in coordinates: how far the fit without a block may be from the fit with it
SHARES = (1.0, 0.5, 0.25)  # of that step that are tried


def block_spans(lengths: Sequence[int], tau: float, settings: Settings) -> list[tuple[int, int, int]]:
    """Return run, first and last sample of blocks: contiguous, about `Settings.blocks`, several correlation times ``tau`` long."""
    least = max(settings.correlation_times * tau, sum(lengths) / settings.blocks)
    found = []
    for r, n in enumerate(lengths):
        edges = np.linspace(0, n, max(1, round(n / least)) + 1).astype(int)
        found += [(r, int(a), int(b)) for a, b in pairwise(edges)]
    return found


def left_out(fit: Fit, spans: list[tuple[int, int, int]], scale: Array) -> Array:
    """Return the loss of every block when it is left out, to first order, by output, ``(blocks, outputs)``; outputs divided by ``scale``."""
    losses = []
    for span in spans:
        rows, e = _block(fit, span)
        predicted = e + (fit.J[rows, : fit.shared] @ _newton(fit, span)).reshape(e.shape)
        losses.append(((predicted / scale) ** 2).sum(0))
    return np.array(losses)


def fitted_losses(fit: Fit, spans: list[tuple[int, int, int]], scale: Array) -> Array:
    """Return the loss of every block as it is fitted, by output, ``(blocks, outputs)``; outputs divided by ``scale``."""
    return np.array([((fit.residuals[r][a:b] / scale) ** 2).sum(0) for r, a, b in spans])


def refitted(problem: Problem, horizon: float, fit: Fit, spans: list[tuple[int, int, int]], scale: Array) -> Array:
    """Return the loss of every block when it is left out, simulated after one Newton step, by output, ``(blocks, outputs)``; outputs divided by ``scale``.

    The step is halved until the other blocks and the prior are followed better than by the whole fit; where none is, it is not taken.
    """
    c = Coordinates(problem, fit.point)
    q, losses = c.pack(fit.point), []
    for span in spans:
        step, (r, a, b) = np.zeros(c.size), span
        step[: fit.shared] = _newton(fit, span)
        whole, best = _others(fit, fit.residuals, span) + c.penalty(q), fit.residuals[r][a:b]
        for share in SHARES:
            there = c.unpack(q + share * step)
            residuals = weighted(problem, there, horizon)
            if _others(fit, residuals, span) + c.penalty(c.pack(there)) <= whole:
                best = residuals[r][a:b]
                break
        losses.append(((best / scale) ** 2).sum(0))
    return np.array(losses)


def _block(fit: Fit, span: tuple[int, int, int]) -> tuple[slice, Array]:
    """Return the rows of a block in the Jacobian, and its residual."""
    (r, a, b), p = span, len(fit.sd)
    first = sum(e.size for e in fit.residuals[:r])
    return slice(first + a * p, first + b * p), fit.residuals[r][a:b]


def _newton(fit: Fit, span: tuple[int, int, int]) -> Array:
    """Return the Newton step, in what all recordings share, from the whole fit to the one without a block."""
    rows, e = _block(fit, span)
    w = np.tile(1 / (fit.sd * np.sqrt(fit.tau)), len(e))
    Jw = fit.J[rows, : fit.shared] * w[:, None]
    H = fit.H[: fit.shared, : fit.shared] - Jw.T @ Jw
    H[np.diag_indices_from(H)] += 1e-6 * np.diag(fit.H)[: fit.shared]
    return np.asarray(np.clip(np.linalg.lstsq(H, Jw.T @ (e.ravel() * w), rcond=1e-12)[0], -LONGEST_STEP, LONGEST_STEP))


def _others(fit: Fit, residuals: Sequence[Array], span: tuple[int, int, int]) -> float:
    """Return half the weighted sum of squares of residuals outside a block."""
    (r, a, b), w = span, 1 / (fit.sd * np.sqrt(fit.tau))
    return 0.5 * float(sum(((e * w) ** 2).sum() for e in residuals) - ((residuals[r][a:b] * w) ** 2).sum())


@dataclass(frozen=True, slots=True, eq=False)
class HypothesisEvidence:
    """What a fit path gains on another.

    ``gains`` are twice the logarithm of the ratio of the posteriors in independent samples, less the price of the parameters, by
    horizon. ``share`` is the part of the gap closed at the decision horizon: of the loss on left-out blocks in independent samples,
    and of the distance of the model's numbers from what is stated. ``before`` and ``after`` are the losses of the left-out blocks
    by output, ``(blocks, outputs)``; ``count`` the independent samples of all outputs, ``fixed`` the part of the gain that does not depend on the blocks. ``fitted``
    are the losses of the same blocks, before and after, where they are not left out. ``noise`` is the share of the remaining
    residual power that is known to be noise, since it does not repeat with the excitation; 0 where nothing repeats.
    """

    gains: Mapping[float, float]
    share: float
    before: Array
    after: Array
    count: float
    fixed: float
    fitted: tuple[Array, Array] | None = None
    noise: float = 0.0

    @property
    def gain(self) -> float:
        """The gain at the decision horizon."""
        return list(self.gains.values())[-1]

    @property
    def closed(self) -> float:
        """The gain as a share: 1 - exp(-gain per independent sample)."""
        return float(self.closing(np.array(self.gain)))

    @property
    def explained(self) -> float:
        """The part of the gap that is explained, 0 to 1: the share, or the gain as one where data move numbers away from what is stated."""
        return float(np.clip(max(self.share, self.closed), 0.0, 1.0))

    def closing(self, gain: Array) -> Array:
        """Return gains as shares."""
        return np.asarray(1 - np.exp(-np.clip(gain / self.count, -5.0, 50.0)))

    def resampled(self, drawn: NDArray[np.int64], fitted: bool = False) -> Array:
        """Return the gain for blocks drawn with replacement, ``drawn (resamples, blocks)``, left out or ``fitted``; the noise variance of every output is estimated from its own residual."""
        before, after = self.fitted if fitted and self.fitted else (self.before, self.after)
        ratio = before[drawn].sum(1) / np.maximum(after[drawn].sum(1), 1e-300)
        return np.asarray(self.count * np.log(ratio).mean(-1) + self.fixed)

    def improves(self, resamples: int) -> float:
        """Return the share of resamplings of the blocks in which there is a gain."""
        blocks = len(self.before)
        return float(np.mean(self.resampled(np.random.default_rng(blocks).integers(0, blocks, (resamples, blocks))) > 0))


Path = Mapping[float, Fit]
Losses = tuple[Array, Array]


def hypothesis_evidence(
    path: Path, base: Path, mine: Losses, theirs: Losses, gap: float, parameters: int, taus: Mapping[float, float], noise: float
) -> HypothesisEvidence:
    """Return the evidence of a path over the base path; ``gap`` is what could be closed at the decision horizon.

    ``mine`` and ``theirs`` are the losses of their blocks, left out and fitted; ``taus`` the correlation times that samples are counted by,
    the same for all hypotheses that are compared; ``noise`` the share of the path's residual power that is known to be noise.
    """
    last = list(path)[-1]
    taken = float(theirs[0].sum() - mine[0].sum()) / taus[last]
    eased = _eased(path[last], base[last])
    count = path[last].samples / taus[last]
    fixed = eased - parameters * np.log(max(8.0, count))
    gains = {h: _gain(path[h], base[h], parameters, taus[h]) for h in path}
    return HypothesisEvidence(gains, (taken + eased) / gap, theirs[0], mine[0], count * len(path[last].sd), fixed, (theirs[1], mine[1]), noise)


def noise_times(paths: Sequence[Path]) -> dict[float, float]:
    """Return by horizon the correlation time of what the fit that leaves least leaves: of all, the nearest to the noise.

    Compared with their own correlation times, hypotheses whose misfit is short-lived would gain most.
    """
    return {h: min((path[h] for path in paths), key=lambda f: f.deviance).own_tau for h in paths[0]}


def _gain(fit: Fit, base: Fit, parameters: int, tau: float) -> float:
    likelihood = (base.deviance - fit.deviance) / tau
    return float(likelihood + _eased(fit, base) - parameters * np.log(max(8.0, fit.samples / tau)))


def _eased(fit: Fit, base: Fit) -> float:
    """Return how much nearer a fit stays to what is known beforehand, twice the logarithm."""
    return 2 * (base.penalty - fit.penalty) + base.narrowed - fit.narrowed
