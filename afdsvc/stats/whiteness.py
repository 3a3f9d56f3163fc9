"""Is the residual consistent with the design of the detectors: white, zero mean, of the stated covariance?

Sums over lagged products are kept while quiet samples stream by; the test is a function of the sums:

* portmanteau statistic ``Q = n^2 sum_k tr(C_k' C_0^-1 C_k C_0^-1) / (n - k)``, chi-squared with ``p^2 L`` degrees of
  freedom for white data (J. R. M. Hosking, *J. Amer. Statist. Assoc.* 75, 1980; the multivariate Ljung-Box test);
* covariance: the likelihood-ratio test of the sample covariance against the stated one;
* offset: ``n mean' mean`` of the normalised residual.

Under a fault the loop's own noise passes through the fault, so the residual is coloured although nothing is wrong
with the model. The sums therefore also hold the products with the faults' regressors: ``r - theta_i psi_i`` can be
tested for any fault and severity without seeing the data again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.special import chdtrc

from afdsvc.api.evidence import p_value_text
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True, eq=False)
class LagSums:
    """Sums over n samples of normalised series ``s_0`` (residual) and ``s_1 .. s_K`` (regressors).

    ``residual (L+1, p, p)`` holds ``sum s_0[t] s_0[t-k]'``; ``cross (L+1, K, p, p)`` both mixed products added, ``own
    (L+1, K, p, p)`` those of the regressors, ``mean (1+K, p)`` plain sums. ``past (L, 1+K, p)`` are the last samples
    seen, ``seen`` how many of them are real.
    """

    n: int
    residual: Array
    cross: Array
    own: Array
    mean: Array
    past: Array
    seen: int

    @classmethod
    def empty(cls, lags: int, faults: int, outputs: int) -> LagSums:
        """Return sums over nothing."""
        if lags < 1 or outputs < 1:
            raise BadInput(f"{lags} lags of {outputs} outputs; expected at least one of each")
        shape = (lags + 1, faults, outputs, outputs)
        residual, mean = np.zeros((lags + 1, outputs, outputs)), np.zeros((1 + faults, outputs))
        past = np.zeros((lags, 1 + faults, outputs))
        return cls(0, residual, np.zeros(shape), np.zeros(shape), mean, past, 0)

    @property
    def lags(self) -> int:
        """Number of lags L."""
        return int(self.residual.shape[0]) - 1

    def add(self, series: Array) -> LagSums:
        """Return the sums with the samples ``series (n, 1 + K, p)`` added, which follow the earlier ones without a
        gap.
        """
        residual, cross, own, mean = self.residual.copy(), self.cross.copy(), self.own.copy(), self.mean.copy()
        window = np.ascontiguousarray(np.concatenate([self.past, series]))
        back = np.ascontiguousarray(window.transpose(1, 2, 0)[:, :, ::-1])  # the sample k earlier lies k later
        _accumulate(window, back, self.lags, self.seen, residual, cross, own, mean)
        seen = min(self.lags, self.seen + len(series))
        past = window[len(window) - self.lags :].copy()
        return LagSums(self.n + len(series), residual, cross, own, mean, past, seen)

    def cleared(self) -> LagSums:
        """Return empty sums that continue after the same past samples."""
        zero = np.zeros_like
        return replace(
            self, n=0, residual=zero(self.residual), cross=zero(self.cross), own=zero(self.own), mean=zero(self.mean)
        )

    def __add__(self, later: LagSums) -> LagSums:
        return LagSums(
            self.n + later.n, self.residual + later.residual, self.cross + later.cross, self.own + later.own,
            self.mean + later.mean, later.past, later.seen,
        )

    def without(self, fault: int, theta: float) -> tuple[Array, Array]:
        """Return lagged products ``(L+1, p, p)`` and sum ``(p,)`` of the residual with one fault's share taken out."""
        products = self.residual - theta * self.cross[:, fault] + theta**2 * self.own[:, fault]
        return products, self.mean[0] - theta * self.mean[1 + fault]

    def severity(self, fault: int) -> tuple[float, float]:
        """Return the least-squares severity and its standard error (inf when the fault left no trace)."""
        information = float(np.trace(self.own[0, fault]))
        if information <= 0:
            return 0.0, math.inf
        return 0.5 * float(np.trace(self.cross[0, fault])) / information, information**-0.5


@dataclass(frozen=True, slots=True)
class Whiteness:
    """p-values of the three tests over ``n`` samples, and found over stated standard deviation per output."""

    n: int
    portmanteau: float
    covariance: float
    offset: float
    sd_ratio: tuple[float, ...]

    @property
    def p(self) -> float:
        """p-value of all three together (Bonferroni, never above 1)."""
        return min(1.0, 3 * min(self.portmanteau, self.covariance, self.offset))

    def reason(self, level: float) -> str:
        """Return a sentence for the test that failed hardest, "" when the residual passes at ``level``."""
        if self.p >= level:
            return ""
        if self.covariance <= min(self.portmanteau, self.offset):
            ratios = ", ".join(f"{r:.3g}" for r in self.sd_ratio)
            return f"the quiet residual has {ratios} times the stated standard deviation ({p_value_text(self.covariance)})"
        if self.portmanteau <= self.offset:
            return f"the quiet residual is not white ({p_value_text(self.portmanteau)}): the model is incomplete"
        return f"the mean of the quiet residual is not zero ({p_value_text(self.offset)})"


def whiteness(sums: LagSums, estimated: int = 0) -> Whiteness:
    """Return the tests of the residual itself; raises `BadInput` when there are fewer than ten samples per lag.

    ``estimated`` counts the samples that the stated covariance was itself estimated from (0: known): two estimates then differ by the
    errors of both.
    """
    return _tests(sums.n, sums.residual, sums.mean[0], estimated)


def whiteness_without(sums: LagSums, fault: int, theta: float, estimated: int = 0) -> Whiteness:
    """Return the tests of ``r - theta psi`` for one fault."""
    return _tests(sums.n, *sums.without(fault, theta), estimated)


def _tests(n: int, products: Array, total: Array, estimated: int) -> Whiteness:
    lags, p = products.shape[0] - 1, products.shape[1]
    if n < 10 * lags:
        raise BadInput(f"{n} quiet samples for {lags} lags; expected at least {10 * lags}")
    C0 = products[0] / n
    sd = tuple(float(v) for v in np.sqrt(np.maximum(np.diag(C0), 0.0)))
    if not np.isfinite(products).all() or np.linalg.cond(C0) > 1e12 or np.linalg.eigvalsh(C0)[0] <= 0:  # a residual that diverges
        return Whiteness(n, 0.0, 0.0, 1.0, sd)
    inverse = np.linalg.inv(C0)
    scaled = products[1:] / n
    terms = np.einsum("kji,jl,klm,mi->k", scaled, inverse, scaled, inverse)
    Q = float(np.sum(n * n / (n - np.arange(1, lags + 1)) * terms))
    likelihood = n * (float(np.trace(C0)) - math.log(float(np.linalg.det(C0))) - p)
    dof = p * (p + 1) / 2
    bartlett = 1 + (2 * p + 1 - 2 / (p + 1)) / (6 * n)  # brings the mean of the ratio to its degrees of freedom
    both = 1 + n / estimated if estimated else 1.0
    return Whiteness(
        n, float(chdtrc(p * p * lags, Q)), float(chdtrc(dof, max(likelihood / bartlett / both, 0.0))),
        float(chdtrc(p, float(total @ total) / n)), sd,
    )


@njit(cache=True)
def _accumulate(window, back, lags, seen, residual, cross, own, mean):  # type: ignore[no-untyped-def]
    """Add the products of every sample with those before it; every sum is built in the order of the samples.

    ``back`` is the window with time running backwards along memory, so that all lags are added at once.
    """
    T, S, p = window.shape
    K = S - 1
    plain, mixed, alone = np.empty((p, p, lags + 1)), np.empty((K, p, p, lags + 1)), np.empty((K, p, p, lags + 1))
    _move(residual, cross, own, plain, mixed, alone, True)
    for t in range(lags, T):
        o, n = T - 1 - t, min(lags, seen + t - lags) + 1
        for f in range(S):
            for i in range(p):
                mean[f, i] += window[t, f, i]
        for j in range(p):
            b = back[0, j, o : o + n]
            for i in range(p):
                _add_times(window[t, 0, i], b, plain[i, j, :n])
            for f in range(K):
                c = back[1 + f, j, o : o + n]
                for i in range(p):
                    _add_both(window[t, 1 + f, i], window[t, 0, i], b, c, mixed[f, i, j, :n], alone[f, i, j, :n])
    _move(residual, cross, own, plain, mixed, alone, False)


@njit(cache=True, inline="always")
def _add_times(a, b, out):  # type: ignore[no-untyped-def]
    for k in range(out.size):
        out[k] += a * b[k]


@njit(cache=True, inline="always")
def _add_both(now, a, b, then, mixed, alone):  # type: ignore[no-untyped-def]
    for k in range(mixed.size):
        mixed[k] += now * b[k] + a * then[k]
        alone[k] += now * then[k]


@njit(cache=True)
def _move(residual, cross, own, plain, mixed, alone, there):  # type: ignore[no-untyped-def]
    """Move the sums between lags first and lags last, ``there`` or back."""
    for k in range(plain.shape[2]):
        for i in range(plain.shape[0]):
            for j in range(plain.shape[1]):
                if there:
                    plain[i, j, k] = residual[k, i, j]
                else:
                    residual[k, i, j] = plain[i, j, k]
                for f in range(mixed.shape[0]):
                    if there:
                        mixed[f, i, j, k], alone[f, i, j, k] = cross[k, f, i, j], own[k, f, i, j]
                    else:
                        cross[k, f, i, j], own[k, f, i, j] = mixed[f, i, j, k], alone[f, i, j, k]
