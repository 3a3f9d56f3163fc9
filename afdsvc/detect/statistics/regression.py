"""Exact regression of the residual on what each fault would add: ``r = theta_i psi_i + d``.

With ``psi_i = theta_i f`` (`shared`) only ``sum f r'`` and ``sum f f'`` are kept over a burst; ``b_i = sum psi_i' Xi^-1 r``
and ``G_ij = sum psi_i' Xi^-1 psi_j`` of any number of faults follow at its end. ``t_i = -b_i / sqrt(G_ii)`` is the
signed root of the likelihood ratio for a severity below 0; the burst is judged by the largest.
Given G the t_i have the correlations of G, so the threshold of their maximum follows as for matched filters.

psi is driven by the very noise it is regressed on, so the normaliser is random and t_i is neither centred nor of unit
variance in short bursts; mean and variance to order 1/n are computed from the loop (`noise_driven`) and taken out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.burst_detector import BurstSamples, Finding
from afdsvc.detect.features.demodulation import Basis, BasisSums, project
from afdsvc.detect.features.nuisances import NONE, Cleaning, Nuisances
from afdsvc.detect.features.regressors import Regressors
from afdsvc.detect.features.shared_filter import Filters
from afdsvc.detect.features.sums import Products
from afdsvc.detect.isolation import anything_log_evidence, linear_fit, weights
from afdsvc.detect.thresholds import maximum
from afdsvc.detect.thresholds.regressor_information import NoiseDriven, noise_driven
from afdsvc.lti.statespace import Array

UNSEEN = 1e-9  # a fault whose information is below this share of the best seen one is invisible to this burst
CURVATURE = 2.0  # errors of first-order severities seen are 1.2 to 2.2 times the severity's square


@dataclass(frozen=True, slots=True, eq=False)
class RegressionSums:
    """Products of residual and features, the residual on the excited lines, and the nuisances learnt so far."""

    products: Products
    lines: BasisSums
    cleaning: Cleaning | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Regression:
    """Statistic of the regression detector. ``false_alarm`` is per burst, ``bounds`` those of the severities, ``sd``
    the standard deviations of the model's uncertain parameters, which are averaged out, ``nuisances`` what is projected
    out of residual and regressors, ``theta (K, p, F)`` makes the regressors from the features in the series. Severities of
    the standard errors of the faults of ``first_order`` include twice the square of the severity.
    """

    names: tuple[str, ...]
    sd: Array
    outputs: int
    false_alarm: float
    bounds: tuple[float, float]
    noise: NoiseDriven
    theta: Array
    nuisances: Nuisances = NONE
    first_order: frozenset[str] = frozenset()

    def start(self, burst: Burst, dt: float) -> RegressionSums:
        """Return empty sums."""
        products = Products.empty(*self.theta.shape[1:])
        return RegressionSums(products, BasisSums.empty(Basis(_omega(burst)), self.outputs))

    def step(self, sums: RegressionSums, samples: BurstSamples) -> tuple[RegressionSums, None]:
        """Return the sums with the samples added."""
        cleaning, clean, _ = self.nuisances.clean(sums.cleaning, samples.block, samples.series)
        e, angle = samples.series[:, 0], self.nuisances.angles(samples.block)
        basis = self.nuisances.basis(_omega(samples.block.burst), angle is not None)
        lines = sums.lines if sums.products.n else BasisSums.empty(basis, self.outputs)
        lines = lines.add(basis, samples.first, samples.dt, e, angle)
        return RegressionSums(sums.products.add(clean), lines, cleaning), None

    def decide(self, sums: RegressionSums, burst: Burst, dt: float) -> Sequence[Finding]:
        """Return one finding for all outputs together."""
        b, G = self.normal_equations(sums)
        statistic, h = self.judged(sums.products.n, b, G, burst)
        both = zip(self.names, b, np.diag(G), strict=True)
        fits = tuple(linear_fit(name, float(v), float(g), self.bounds) for name, v, g in both)
        parts = {"samples": float(sums.products.n)}
        adjusted = tuple(replace(f, sd=float(np.hypot(f.sd, CURVATURE * f.severity**2))) if f.fault in self.first_order else f for f in fits)
        return [Finding(statistic, h, adjusted, weights(fits, self._anything(sums, burst)), parts)]

    def test(self, sums: RegressionSums, burst: Burst) -> tuple[float, float]:
        """Return statistic and threshold only."""
        return self.judged(sums.products.n, *self.normal_equations(sums), burst)

    def normal_equations(self, sums: RegressionSums) -> tuple[Array, Array]:
        """Return score ``(K,)`` and information ``(K, K)`` of the faults, uncertain parameters averaged out."""
        return averaged_out(sums.products.score(self.theta), sums.products.information(self.theta), self.sd)

    def judged(self, samples: int, b: Array, G: Array, burst: Burst) -> tuple[float, float]:
        """Return the largest signed root and its threshold for normal equations of the faults over so many samples."""
        information = np.diag(G)
        seen = np.flatnonzero(information > UNSEEN * max(information.max(initial=0.0), 1e-300))
        if not len(seen):
            return 0.0, float("inf")
        t = -b[seen] / np.sqrt(information[seen])
        correlation = G[np.ix_(seen, seen)] / np.sqrt(np.outer(information[seen], information[seen]))
        mean, sd = (v[seen] for v in self.noise.signed_root(samples, burst))
        return float(np.max((t - mean) / sd)), maximum.threshold(_square_root(correlation), self.false_alarm)

    def _anything(self, sums: RegressionSums, burst: Burst) -> float | None:
        basis = self.nuisances.basis(_omega(burst), True)
        if len(sums.lines.G) != basis.columns:
            basis = self.nuisances.basis(_omega(burst), False)
        return anything_log_evidence(project(sums.lines, basis).z) if basis.omega else None


def averaged_out(b: Array, G: Array, sd: Array) -> tuple[Array, Array]:
    """Return score and information of the faults when the last ``len(sd)`` parameters are N(0, sd^2) and averaged
    over.
    """
    K = len(b) - len(sd)
    if not len(sd):
        return b, G
    gain = np.linalg.solve(G[K:, K:] + np.diag(1 / sd**2), np.column_stack([b[K:], G[K:, :K]]))
    return b[:K] - G[:K, K:] @ gain[:, 0], G[:K, :K] - G[:K, K:] @ gain[:, 1:]


def regression(
    problem: DetectionProblem, filters: Filters, nuisances: Nuisances = NONE
) -> Regression:
    """Return the statistic for one machine and the filters whose series it is shown."""
    p, rate = problem.plant.outputs, problem.false_alarms.per_burst
    noise = noise_driven(problem, filters if isinstance(filters, Regressors) else None)
    first_order = frozenset(n for n, exact in zip(filters.names, filters.exact, strict=False) if not exact)
    return Regression(problem.fault_names, filters.sd, p, rate, problem.severity_range, noise, filters.theta, nuisances, first_order)


def _omega(burst: Burst | None) -> tuple[float, ...]:
    return () if burst is None else tuple(sorted({line.omega for line in burst.lines}))


def _square_root(correlation: Array) -> Array:
    """Return vectors ``(K, K)`` whose inner products are the correlations."""
    values, vectors = np.linalg.eigh(correlation)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
