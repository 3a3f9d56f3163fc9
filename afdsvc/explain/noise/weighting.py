"""How residuals are weighted: by the noise where it is known, evenly over frequency where the model limits, or by their own spectrum.

The excitation repeats in designed experiments; what differs between periods is noise, and its power per band is known apart
from the model. The unexplained power above it, of which nothing is known, is spread evenly over frequency. The sum is what a
residual is divided by. Without repetition the weighting is even: the residual itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft as sfft

from afdsvc.dataset.experiment import Run
from afdsvc.lti.statespace import Array

LOWEST, WIDER = 16, 1.4  # coefficients in the lowest band; every further band is wider by this factor
LEAST = 1e-6  # power in any band, over the mean power: what a residual holds below it is rounding


@dataclass(frozen=True, slots=True, eq=False)
class Weighting:
    """Divides the cosine transform of a residual by ``density``.

    ``density (k, p)`` is the standard deviation at the normalised frequencies ``at (k,)`` (0 to 1, of half the sample rate);
    ``floor (p,)`` the power of the noise alone and ``noise (p,)`` that of the weighted noise, NaN where nothing repeats.
    """

    at: Array
    density: Array
    floor: Array
    noise: Array

    @property
    def measured(self) -> bool:
        """Whether the noise is known apart from the model."""
        return bool(np.isfinite(self.floor).all())

    @property
    def even(self) -> bool:
        """Whether every frequency counts the same."""
        return len(self.at) == 1

    def __call__(self, residual: Array) -> Array:
        """Return the weighted residual, ``(n, p)``."""
        if self.even:
            return residual if (self.density == 1).all() else np.asarray(residual / self.density[0])
        n = len(residual)
        frequency = (np.arange(n) + 0.5) / n
        divisor = np.column_stack([np.interp(frequency, self.at, d) for d in self.density.T])
        return np.asarray(sfft.idct(sfft.dct(residual, axis=0, norm="ortho") / divisor, axis=0, norm="ortho"))


def even(p: int) -> Weighting:
    """Return the weighting that leaves a residual as it is."""
    return Weighting(np.zeros(1), np.ones((1, p)), np.full(p, np.nan), np.full(p, np.nan))


def weighting(runs: Sequence[Run], residuals: Sequence[Array]) -> Weighting:
    """Return the weighting of residuals at a fit: noise from what differs between periods, plus the rest spread evenly."""
    noise = noises(runs, residuals)
    power = np.mean(np.vstack(residuals) ** 2, axis=0)
    if not noise:
        return even(residuals[0].shape[1])
    at, width, variance = _bands(noise)
    floor = np.mean(np.vstack(noise) ** 2, axis=0)
    density = variance + np.maximum(power - floor, 0.0) + 1e-12 * power
    return Weighting(at, np.sqrt(density), floor, width @ (variance / density))


def own(residuals: Sequence[Array], noise: Array) -> Weighting:
    """Return the weighting that divides residuals by their own spectrum (generalised least squares): slow noise hides less.

    ``noise (p,)`` is the share of the weighted power that is taken to be noise.
    """
    at, _, variance = _bands(residuals)
    power = np.mean(np.vstack(residuals) ** 2, axis=0)
    return Weighting(at, np.sqrt(variance + LEAST * power), np.full(len(power), np.nan), noise)


def noises(runs: Sequence[Run], residuals: Sequence[Array]) -> list[Array]:
    """Return the noise of every run that repeats: what differs between the periods of its residual."""
    return [d for d in (differing(r, e) for r, e in zip(runs, residuals, strict=True)) if d is not None]


def noise_share(runs: Sequence[Run], residuals: Sequence[Array]) -> float:
    """Return the share of residuals that is noise, the mean over outputs; 0 where nothing repeats."""
    noise = noises(runs, residuals)
    return float(np.mean(np.mean(np.vstack(noise) ** 2, axis=0) / np.mean(np.vstack(residuals) ** 2, axis=0))) if noise else 0.0


def differing(run: Run, residual: Array) -> Array | None:
    """Return what differs between the periods of a residual, scaled to the noise's variance; None without two whole periods."""
    count = (len(residual) - run.settled) // run.period if run.period else 0
    if count < 2:
        return None
    periods = residual[run.settled : run.settled + count * run.period].reshape(count, run.period, -1)
    differing = (periods - periods.mean(0)) * np.sqrt(count / (count - 1))
    return np.asarray(differing.reshape(count * run.period, -1))


def _bands(pieces: Sequence[Array]) -> tuple[Array, Array, Array]:
    """Return centre frequencies, widths and mean power of the bands of the cosine transform, lowest first."""
    n = min(len(x) for x in pieces)
    edges = [0]
    while edges[-1] < n:
        edges.append(min(n, edges[-1] + max(LOWEST, int((WIDER - 1) * edges[-1]))))
    if len(edges) > 2 and edges[-1] - edges[-2] < LOWEST:
        edges.pop(-2)
    share = np.array(edges) / n
    power = np.zeros((len(edges) - 1, pieces[0].shape[1]))
    count = np.zeros((len(edges) - 1, 1))
    for x in pieces:
        band = np.clip(np.searchsorted(share, (np.arange(len(x)) + 0.5) / len(x), side="right") - 1, 0, len(edges) - 2)
        c = sfft.dct(x, axis=0, norm="ortho") ** 2
        np.add.at(power, band, c)
        np.add.at(count, band, 1.0)
    return 0.5 * (share[1:] + share[:-1]), np.diff(share), power / count


def correlation_time(residuals: Sequence[Array]) -> float:
    """Return the integrated correlation time of residuals in samples, at least 1, the mean over outputs.

    The sum of the autocorrelation is cut at the first non-positive pair (Geyer 1992, initial positive sequence).
    """
    p = residuals[0].shape[1]
    return float(np.mean([_integrated([e[:, j] for e in residuals]) for j in range(p)]))


def power_time(residuals: Sequence[Array]) -> float:
    """Return the time in samples after which the power of residuals is independent, at least `correlation_time`, the mean over outputs.

    It is the sum of the squared autocorrelation (Bartlett 1946), here from periodograms, whose squares are twice those of the density on average. The sum
    of the autocorrelation itself is cut at the first zero of an oscillation, however long that lasts.
    """
    spectra = [np.abs(sfft.rfft(e, axis=0)[1:]) ** 2 for e in residuals]
    squares = sum(0.25 * len(e) ** 2 * (s**2).sum(0) / np.maximum(s.sum(0) ** 2, 1e-300) for e, s in zip(residuals, spectra, strict=True))
    return max(correlation_time(residuals), float(np.mean(squares)) / sum(map(len, residuals)))


def _integrated(pieces: Sequence[Array]) -> float:
    longest = max(len(e) for e in pieces)
    total = np.zeros(longest)
    for e in pieces:
        n = len(e)
        spectrum = np.abs(sfft.rfft(e - e.mean(), 2 * n)) ** 2
        total[:n] += sfft.irfft(spectrum)[:n]
    if not total[0] > 0:
        return 1.0
    c = total / total[0]
    pairs = c[1 : longest // 3 - 1 : 2] + c[2 : longest // 3 : 2]
    stop = int(np.argmax(pairs <= 0)) if (pairs <= 0).any() else len(pairs)
    return max(1.0, 1.0 + 2.0 * float(pairs[:stop].sum()))
