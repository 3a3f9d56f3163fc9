"""Exact regression of the residual on what each fault would add: ``r = theta_i psi_i + d``.

With ``psi_i = theta_i f`` (`shared`) only ``sum f r'`` and ``sum f f'`` are kept over a burst; ``b_i = sum psi_i' Xi^-1 r``
and ``G_ij = sum psi_i' Xi^-1 psi_j`` of any number of faults follow at its end. ``t_i = -b_i / sqrt(G_ii)`` is the
signed root of the likelihood ratio for a severity below 0; the burst is judged by the largest.
Given G the t_i have the correlations of G, so the threshold of their maximum follows as for matched filters.

psi is driven by the very noise it is regressed on, so the normaliser is random and t_i is neither centred nor of unit
variance in short bursts; mean and variance to order 1/n are computed from the loop (`noise_driven`) and taken out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.burst_detector import BurstFinding, BurstSamples
from afdsvc.detect.combinations import OPEN, Combination, alike, besides, combined, course, likeliest_combination, paired
from afdsvc.detect.features.burst_noise import energy, noise_compared
from afdsvc.detect.features.demodulation import Basis, BasisSums, project
from afdsvc.detect.features.nuisances import NONE, Cleaning, Nuisances
from afdsvc.detect.features.regressors import no_return
from afdsvc.detect.features.shared_filter import Filters
from afdsvc.detect.features.sums import Products
from afdsvc.detect.isolation import NONE as NONE_OF_THESE
from afdsvc.detect.isolation import Fit, anything_log_evidence, limited, linear_fit, weights
from afdsvc.detect.statistics.binding_function import BindingFunction
from afdsvc.detect.thresholds import maximum
from afdsvc.detect.thresholds.regressor_information import NoiseDriven, noise_driven
from afdsvc.lti.statespace import Array

UNSEEN = 1e-9  # a fault whose information is below this share of the best seen one is invisible to this burst
PARTS = 8  # of a burst, each with its own severity
CONSTANT = 1e-3  # p-value below which a severity is said to have changed, or energy to be unexplained
LIKELY = 0.01  # weight from which a fault's severity is worth the time to take its bias out
CURVATURE = 2.0  # errors of first-order severities seen are 1.2 to 2.2 times the severity's square


@dataclass(frozen=True, slots=True, eq=False)
class RegressionSums:
    """Products of residual and features, the residual on the excited lines, the nuisances learnt so far, the energy of the residual, and
    products and energy as they were at the end of every part of the burst."""

    products: Products
    lines: BasisSums
    cleaning: Cleaning | None = None
    energy: float = 0.0
    parts: tuple[tuple[Products, float], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Regression:
    """Statistic of the regression detector. ``false_alarm`` is per burst, ``bounds`` those of the severities, ``sd``
    the standard deviations of the model's uncertain parameters, which are averaged out, ``nuisances`` what is projected
    out of residual and regressors, ``theta (K, p, F)`` makes the regressors from the features in the series. Severities of the faults of
    ``first_order`` are biased; ``loop`` gives by how much, None where the controller is not known: then standard errors include twice the
    square of the severity. ``estimated`` counts the samples that
    the noise was estimated from (0: stated); faults of ``feedthrough`` do not change the signal they multiply, but for the loop.
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
    estimated: int = 0
    feedthrough: frozenset[str] = frozenset()
    loop: DetectionProblem | None = None

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
        assert samples.block.burst is not None  # noqa: S101 - the frame hands over samples of bursts only
        length, products, total, parts = -(-samples.block.burst.samples // PARTS), sums.products, sums.energy, sums.parts
        edges = range(samples.first - samples.first % length + length, samples.first + len(clean), length)
        for a, b in pairwise((samples.first, *edges, samples.first + len(clean))):
            part = clean[a - samples.first : b - samples.first]
            products, total = products.add(part), energy(np.ascontiguousarray(part[:, 0]), total)
            parts = (*parts, (products, total)) if b % length == 0 or b == samples.block.burst.samples else parts
        return RegressionSums(products, lines, cleaning, total, parts), None

    def decide(self, sums: RegressionSums, burst: Burst, dt: float) -> Sequence[BurstFinding]:
        """Return one finding for all outputs together."""
        b, G = self.normal_equations(sums)
        statistic, h = self.judged(sums.products.n, b, G, burst)
        both = zip(self.names, b, np.diag(G), strict=True)
        fits = tuple(linear_fit(name, float(v), float(g), self.bounds) for name, v, g in both)
        parts, weight = {"samples": float(sums.products.n)}, weights(fits, self._anything(sums, burst))
        limits = self._limited(fits, sums.products.n, b, G, burst, h)
        adjusted = tuple(self._unbiased(f, burst, statistic > h and weight[f.fault] > LIKELY) for f in limits)
        finding = BurstFinding(statistic, h, adjusted, weight, parts)
        return [self._explained(finding, sums, b, G) if statistic > h else finding]

    def _unbiased(self, fit: Fit, burst: Burst, likely: bool) -> Fit:
        """Return the fit of a fault of first order without its bias; where that is not known, and of faults that are not likely, with a bound."""
        if fit.fault not in self.first_order or not math.isfinite(fit.sd):
            return fit
        known = likely and self.loop is not None and burst.waveform is None and not len(self.sd)
        binding = BindingFunction(self.loop, fit.fault, burst) if known and self.loop else None
        found = binding.inverse(fit.severity) if binding else None
        if found is None or binding is None:
            bias = CURVATURE * fit.severity**2
            return replace(fit, sd=float(np.hypot(fit.sd, bias)), bias=bias)
        severity, slope = found
        return replace(fit, severity=severity, sd=fit.sd * binding.spread(severity) / slope, limit=severity + (fit.limit - fit.severity) / slope)

    def _limited(self, fits: tuple[Fit, ...], samples: int, b: Array, G: Array, burst: Burst, threshold: float) -> tuple[Fit, ...]:
        """Return the fits with their limits of detection."""
        seen, root = np.flatnonzero(np.diag(G) > 0), np.sqrt(np.maximum(np.diag(G), 1e-300))
        mean, sd = (v[: len(b)] for v in self.noise.signed_root(samples, burst))
        excess = (-b / root - mean) / sd - threshold
        return tuple(limited(f, excess[seen], (-G[seen, i] / root[seen]) / sd[seen]) for i, f in enumerate(fits))

    def _explained(self, finding: BurstFinding, sums: RegressionSums, b: Array, G: Array) -> BurstFinding:
        """Return a finding that two faults explain, or one whose fault changed during the burst, or what remains unexplained."""
        n, seen = sums.products.n, np.flatnonzero(np.diag(G) > UNSEEN * np.diag(G).max(initial=0.0)).tolist()
        found = combined(b, G, seen, self.bounds)
        single, pair = likeliest_combination(found, 1), likeliest_combination(found, 2)
        if single is None:
            return finding
        if pair and pair.score(n) - single.score(n) > self._bent(single, G, n) / 2 + math.log(OPEN):
            return self._left(paired(finding, found, pair, self.names, n), sums, pair, b, G)
        parts = {**alike(found, single, self.names), **besides(b, G, single, seen, self.names, self.bounds[0])}
        finding = replace(finding, parts={**finding.parts, **parts})
        changed = self._changed(finding, sums, single)
        return changed if changed is not finding else self._left(finding, sums, single, b, G)

    def _changed(self, finding: BurstFinding, sums: RegressionSums, single: Combination) -> BurstFinding:
        """Return the finding with the course of its fault and its severity at the end, where the fault did not stay the same."""
        if not sums.parts:
            return finding
        i = single.faults[0]
        products = [products for products, _ in sums.parts]
        b, G = (np.array(v) for v in zip(*(self._own(p, i) for p in products), strict=True))
        over_time = course(np.diff(b, prepend=0.0), np.diff(G, prepend=0.0))
        bent = 0.0 if over_time is None or self.names[i] not in self.first_order else CURVATURE * float(single.severity[0]) ** 2
        if over_time is None or not over_time.p < CONSTANT or np.ptp(over_time.severity) < 2 * bent:
            return finding
        severity, sd = over_time.now()
        fits = tuple(replace(f, severity=float(np.clip(severity, *self.bounds)), sd=sd, limit=math.inf) if f.fault == self.names[i] else f for f in finding.fits)
        parts = {f"course.{k}": float(s) for k, s in enumerate(over_time.severity)}
        return replace(finding, fits=fits, parts={**finding.parts, **parts, "course_p": over_time.p, "onset_part": float(over_time.onset)})

    def _own(self, products: Products, fault: int) -> tuple[float, float]:
        theta = self.theta[fault : fault + 1]
        return float(products.score(theta)[0]), float(products.information(theta)[0, 0])

    def _left(self, finding: BurstFinding, sums: RegressionSums, best: Combination, b: Array, G: Array) -> BurstFinding:
        """Return the finding without a name where the residual holds more energy than noise and the best explanation."""
        own = list(best.faults)
        left = sums.energy - 2 * float(best.severity @ b[own]) + float(best.severity @ G[np.ix_(own, own)] @ best.severity)
        left -= self._bent(best, sums.products.information(self.theta), sums.products.n) + self._uncertain(sums)
        share, p = noise_compared(left, sums.products.n * self.outputs, self.estimated * self.outputs, CONSTANT)
        if not share > 1.0:
            return finding
        return replace(finding, weights={NONE_OF_THESE: 1.0}, parts={**finding.parts, "unexplained_share": share - 1, "unexplained_p": p})

    def _bent(self, best: Combination, G: Array, n: int) -> float:
        """Return the energy that first-order regressors may leave: of the loop's noise alone where the fault does not feed back on itself."""
        own = [i for i in best.faults if self.names[i] in self.first_order]
        held = {i: min(G[i, i], n * self.noise.passive[i]) if self.names[i] in self.feedthrough else G[i, i] for i in own}
        return float(sum((CURVATURE * float(s) ** 2) ** 2 * held[i] for i, s in zip(best.faults, best.severity, strict=True) if i in held))

    def _uncertain(self, sums: RegressionSums) -> float:
        """Return the energy that the model's uncertain parameters explain."""
        if not len(self.sd):
            return 0.0
        b, G = self._parameters(sums)
        return float(b @ np.linalg.solve(G + np.diag(1 / self.sd**2), b))

    def _parameters(self, sums: RegressionSums) -> tuple[Array, Array]:
        """Return score and information of the uncertain parameters."""
        own = self.theta[len(self.names) :]
        return sums.products.score(own), sums.products.information(own)

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
        return float(np.max((t - mean) / sd)), maximum.maximum_threshold(_square_root(correlation), self.false_alarm)

    def _anything(self, sums: RegressionSums, burst: Burst) -> float | None:
        basis = self.nuisances.basis(_omega(burst), True)
        if len(sums.lines.G) != basis.columns:
            basis = self.nuisances.basis(_omega(burst), False)
        if not basis.omega:
            return None
        # Faults are compared with a healthy machine whose parameters are averaged over; so is an arbitrary wave.
        scale = np.linalg.slogdet(np.eye(len(self.sd)) + self.sd[:, None] * self._parameters(sums)[1] * self.sd)[1] if len(self.sd) else 0.0
        return anything_log_evidence(project(sums.lines, basis).z) - 0.5 * (self._uncertain(sums) - float(scale))


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
    noise = noise_driven(problem)
    first_order = frozenset(n for n, exact in zip(filters.names, filters.exact, strict=False) if not exact)
    s = problem.augmented.system
    straight = frozenset(n for n in problem.fault_names if no_return(s, problem.augmented.channels_of(n)))
    return Regression(
        problem.fault_names, filters.sd, p, rate, problem.severity_range, noise, filters.theta, nuisances, first_order, problem.noise_samples, straight,
        problem if problem.loop_known else None,
    )


def _omega(burst: Burst | None) -> tuple[float, ...]:
    return () if burst is None else tuple(sorted({line.omega for line in burst.lines}))


def _square_root(correlation: Array) -> Array:
    """Return vectors ``(K, K)`` whose inner products are the correlations."""
    values, vectors = np.linalg.eigh(correlation)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
