"""The part of the residual that repeats with the excitation: noise does not.

Over P periods the mean of the discrete Fourier transforms at a line has power ``S = P |mean|^2``, their scatter ``N``; both have
the same expectation where nothing repeats, whatever the colour of the noise. The ratio of their sums over all lines is F
distributed with ``2 (sum N)^2 / sum N^2`` degrees of freedom (Satterthwaite) and P - 1 times as many. The residual passes an
autoregressive filter first, fitted to what does not repeat in it: without it the two ends of a slow residual differ, the
difference leaks into every line alike, and the lines are no longer independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_distribution

from afdsvc.explain.gap.settings import GapSettings
from afdsvc.explain.gap.signals import ResidualSignals
from afdsvc.explain.noise.surrogates import autoregressive, whiten
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True, eq=False)
class RepeatingShare:
    """Share of the residual's power that repeats ``(p,)``, p-value over all outputs (Bonferroni)."""

    share: Array
    p_value: float


def repeating_share(recordings: Sequence[ResidualSignals], E: Sequence[Array], settings: GapSettings) -> RepeatingShare | None:
    """Return the repeating part of the residuals ``E``; None when no recording has enough whole periods without missing readings."""
    least = settings.least_periods
    usable = [(e, r.period) for e, r in zip(E, recordings, strict=True) if 8 <= r.period <= len(e) // least and np.isfinite(e).all()]
    if not usable:
        return None
    plain = [_lines(e, period) for e, period in usable]
    white = [_lines(_whitened(e, period, settings.whitening_order), period) for e, period in usable]
    outputs = range(E[0].shape[1])
    p = min(_p_value([(s[:, j], n[:, j], d) for s, n, d in white]) for j in outputs)
    return RepeatingShare(np.array([_share([(s[:, j], n[:, j], d) for s, n, d in plain]) for j in outputs]), min(1.0, len(outputs) * p))


def _folded(e: Array, period: int) -> Array:
    """Return the last whole periods ``(periods, period, p)``."""
    return e[len(e) % period :].reshape(-1, period, e.shape[1])


def _lines(e: Array, period: int) -> tuple[Array, Array, int]:
    """Return per line and output the power of the mean and the scatter, and the periods less one."""
    spectra = np.fft.rfft(_folded(e, period), axis=1)[:, 1 : (period + 1) // 2]
    mean, freedom = spectra.mean(0), len(spectra) - 1
    return (freedom + 1) * np.abs(mean) ** 2, (np.abs(spectra - mean) ** 2).sum(0) / freedom, freedom


def _whitened(e: Array, period: int, order: int) -> Array:
    """Return each output ``(n, p)`` through the autoregressive filter of what does not repeat in it."""
    folded = _folded(e, period)
    noise = (folded - folded.mean(0)).reshape(-1, e.shape[1])
    return np.column_stack([whiten(x, autoregressive([w], order)) for x, w in zip(e.T, noise.T, strict=True)])


def _share(parts: Sequence[tuple[Array, Array, int]]) -> float:
    """Return the power that repeats over all power, noise taken from both."""
    signal = sum(float((s - n).sum()) for s, n, _ in parts)
    power = sum(float((s + d * n).sum()) for s, n, d in parts)
    return max(0.0, signal / power) if power > 0 else 0.0


def _p_value(parts: Sequence[tuple[Array, Array, int]]) -> float:
    signal, noise = sum(float(s.sum()) for s, _, _ in parts), sum(float(n.sum()) for _, n, _ in parts)
    if noise <= 0:
        return 0.0 if signal > 0 else 1.0
    freedom = 2 * noise**2 / sum(float((n**2).sum()) for _, n, _ in parts)
    scatter = 2 * noise**2 / sum(float((n**2).sum()) / d for _, n, d in parts)
    return float(f_distribution.sf(signal / noise, freedom, scatter))
