"""Information per sample, and its bias, that the loop's own noise or a burst gives about each fault.

Written in innovations (``xh+ = A xh + B u + Kp r, y = C xh + D u + r``) and closed with J_K, the healthy loop is a
stable system from ``[r, alpha]`` to all psi_i. H_i is its part from normalised r to normalised psi_i. Per sample the
noise brings the information ``int tr(H_i* H_i) dw / 2 pi`` about theta_i, a burst adds ``sum |s|^2 / 2`` over its
lines.

Steps of CUSUMs with noise-driven regressors, where an excursion begins and where it alarms: a boundary is overshot by about half a step, and zero undershot by as much (D. Siegmund, *Sequential Analysis*, 1985). Steps
come in where information comes in, so the mean step there is ``E |s|^3 / E |s|^2``, s being theta psi over one look. An
excursion begins with the healthy loop's psi. Those that alarm look as if the fault were there: at their end psi is that of
the loop in which ``e + theta psi`` stands for e, which the likelihood ratio weights them to. A weakened loop is a quieter one,
so its steps can be half as large.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_lyapunov

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.features.regressors import Regressors, regressors
from afdsvc.errors import BadInput
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import star
from afdsvc.lti.statespace import Array, ComplexArray, StateSpace

_LAGS = 1 << 12  # more when the loop rings long
_MOST = 1 << 16


@dataclass(frozen=True, slots=True, eq=False)
class NoiseDriven:
    """Per-sample cumulants of ``b_i = sum psi_i' e`` and ``G_i = sum psi_i' psi_i`` without a fault.

    ``gram (K, K)`` is the mean of ``sum psi_i' psi_j``, ``passive`` its diagonal (the information). Lag by lag, since
    short windows cut the long lags off: ``skew (M, K)`` half the covariance of b and G, ``spread (M, K)`` the
    variance of G. ``bbg`` and ``bgg (K,)`` are the joint cumulants of b, b, G and of b, G, G.
    """

    loop: StateSpace
    count: int
    gram: Array
    skew: Array
    spread: Array
    bbg: Array
    bgg: Array

    @property
    def passive(self) -> Array:
        """Information per sample that the loop's noise brings about every fault, ``(K,)``."""
        return np.asarray(np.diag(self.gram))

    def excited(self, burst: Burst) -> tuple[Array, Array]:
        """Return what a burst's lines add per sample to information and skew, both ``(K,)``."""
        if not burst.lines:
            return np.zeros(self.count), np.zeros(self.count)
        H, s = self._at_lines(burst)
        skew = 0.5 * np.real(np.einsum("lip,lipq,liq->i", s.conj(), H, s))
        return 0.5 * np.sum(np.abs(s) ** 2, axis=(0, 2)), skew

    def active_gram(self, burst: Burst) -> Array:
        """Return what the lines of a burst add per sample to ``sum psi_i' psi_j``, shape ``(K, K)``."""
        s = self._at_lines(burst)[1]
        return np.asarray(0.5 * np.einsum("lip,ljp->ij", s.conj(), s).real)

    def _at_lines(self, burst: Burst) -> tuple[ComplexArray, ComplexArray]:
        """Return the noise response ``(L, K, p, p)`` and the waves ``(L, K, p)`` at the lines of a burst."""
        H, S = _split(self.loop, self.count, np.array([line.omega for line in burst.lines]))
        waves = [line.amplitude * S[k, :, :, line.input] for k, line in enumerate(burst.lines)]
        return H, np.stack(waves)

    def signed_root(self, samples: int, burst: Burst | None = None) -> tuple[Array, Array]:
        """Return mean and standard deviation of every ``-b_i / sqrt(G_i)`` without a fault.

        A signed root of the likelihood ratio is normal to order ``samples^-3/2`` once these two are corrected (T. J.
        DiCiccio and M. A. Martin, *Biometrika* 80, 1993). With ``x = b / sd(b)``, ``y = G / E G - 1`` both follow
        from the moments of ``x (1 + y)^-1/2``. Faults without information get 0 and 1.
        """
        active, skew = self.excited(burst) if burst is not None else (np.zeros(self.count), np.zeros(self.count))
        information = samples * (self.passive + active)
        safe = np.where(information > 0, information, np.inf)
        cut, whole = _within(self.skew, samples), self.skew.sum(axis=0)
        share = (cut / np.where(whole != 0, whole, 1.0)) ** 2
        xy = 2 * samples * (cut + skew) / safe**1.5
        yy = samples * _within(self.spread, samples) / safe**2
        xxy, xyy = samples * share * self.bbg / safe**2, samples * share * self.bgg / safe**2.5
        mean = xy / 2 + 15 / 16 * xy * yy - 3 / 8 * xyy
        return mean, np.sqrt(np.clip(1 + yy - xxy + 7 / 4 * xy**2, 0.25, 4.0))


def noise_driven(problem: DetectionProblem) -> NoiseDriven:
    """Return the noise-driven part of all regressors of a problem."""
    return problem.once(lambda: _noise_driven(problem, regressors(problem)), "noise-driven regressors")


def _noise_driven(problem: DetectionProblem, f: Regressors) -> NoiseDriven:
    loop, K = _loop(problem, f), len(f.names)
    slowest = float(np.abs(loop.poles()).max(initial=0.0))
    M = int(min(_MOST, max(_LAGS, 2 ** np.ceil(np.log2(20 / max(1 - slowest, 1e-9))))))
    omega: Array = np.arange(M // 2 + 1, dtype=np.float64) * (2 * np.pi / (M * loop.dt))
    H, _ = _split(loop, K, omega)
    adjoint = np.swapaxes(H.conj(), -1, -2)
    C, Q = adjoint @ H, (H + adjoint) / 2
    response, covariance = np.fft.irfft(H, n=M, axis=0), np.fft.irfft(H @ adjoint, n=M, axis=0)
    gram = np.einsum("kipq,kjpq->ij", response, response)
    skew = np.einsum("kipq,kipq->ki", response, covariance)
    spread = 2 * np.einsum("kipq,kipq->ki", covariance, covariance)
    bbg, bgg = (8 * np.fft.irfft(np.trace(X, axis1=2, axis2=3), n=M, axis=0)[0] for X in (Q @ Q @ C, Q @ C @ C))
    return NoiseDriven(loop, K, gram, skew, spread, bbg, bgg)


def _within(by_lag: Array, samples: int) -> Array:
    """Return the sum over lags as a window of so many samples sees it; lags beyond the middle are negative ones."""
    k = np.arange(len(by_lag))
    weight = np.maximum(1 - np.minimum(k, len(by_lag) - k) / samples, 0.0)
    return np.asarray(weight @ by_lag)


def _split(loop: StateSpace, K: int, omega: Array) -> tuple[ComplexArray, ComplexArray]:
    """Return the responses from normalised r ``(W, K, p, p)`` and from alpha ``(W, K, p, m)``."""
    response = frequency_response(loop, omega)
    p = loop.outputs // max(K, 1)
    shaped = response.reshape(len(omega), K, p, loop.inputs)
    return shaped[..., :p], shaped[..., p:]


def _loop(problem: DetectionProblem, f: Regressors) -> StateSpace:
    """Return the healthy loop from ``[normalised r, alpha]`` to all normalised psi."""
    g, K, n, p = f.plant, len(f.names), f.plant.order, f.plant.outputs
    filters = np.kron(np.eye(K), g.A - f.Kp @ g.C)
    into = np.vstack([np.zeros((0, n)), *(f.Bw[i] @ f.Cz[i] for i in range(K))])
    A = np.block([[g.A, np.zeros((n, n * K))], [into, filters]])
    B = np.vstack([np.hstack([f.Kp, g.B]), *(np.hstack([f.Kd[i], f.Bw[i] @ f.Dzu[i]]) for i in range(K))])
    psi = np.hstack([np.vstack([np.zeros((0, n)), *(f.Dyw[i] @ f.Cz[i] for i in range(K))]), np.kron(np.eye(K), g.C)])
    direct = np.vstack([np.zeros((0, g.inputs)), *(f.Dyw[i] @ f.Dzu[i] for i in range(K))])
    C = np.vstack([psi, np.hstack([g.C, np.zeros((p, n * K))])])
    D = np.block([[np.zeros((p * K, p)), direct], [np.eye(p), g.D]])
    closed = star(StateSpace(A, B, C, D, g.dt), problem.interconnection, p, g.inputs)
    scale_out, scale_in = np.kron(np.eye(K), f.Li), np.linalg.inv(f.Li)
    rows = slice(0, p * K)
    into_loop = np.hstack([closed.B[:, :p] @ scale_in, closed.B[:, p:]])
    feed = np.hstack([closed.D[rows, :p] @ scale_in, closed.D[rows, p:]])
    return StateSpace(closed.A, into_loop, scale_out @ closed.C[rows], scale_out @ feed, g.dt)


def excursion_steps(noise: NoiseDriven, which: NDArray[np.intp], theta: Array, samples: int) -> Array:
    """Return the mean of the steps at both ends of an excursion for CUSUMs of the faults ``which`` at severities ``theta``,
    which look once in so many ``samples``; shape ``(K,)``.
    """
    return np.array([_both_ends(noise, int(i), float(th), samples) for i, th in zip(which, theta, strict=True)])


def faulty_information(noise: NoiseDriven, fault: int, severity: float) -> float:
    """Return the information per sample about a fault once it is there; raises `BadInput` when the loop is lost."""
    A, B, C = _driven(noise, fault)
    tilted = A + severity * B @ C
    if np.abs(np.linalg.eigvals(tilted)).max(initial=0.0) >= 1:
        raise BadInput(f"severity {severity:g} makes the loop unstable; expected one it survives")
    return float(np.trace(C @ solve_discrete_lyapunov(tilted, B @ B.T) @ C.T))


def _both_ends(noise: NoiseDriven, fault: int, theta: float, samples: int) -> float:
    A, B, C = _driven(noise, fault)
    begins, tilted = _mean_step(A, B, C, samples), A + theta * B @ C
    alarms = _mean_step(tilted, B, C, samples) if np.abs(np.linalg.eigvals(tilted)).max(initial=0.0) < 1 else begins
    return abs(theta) * (begins + alarms) / 2


def _driven(noise: NoiseDriven, fault: int) -> tuple[Array, Array, Array]:
    """Return the part of the loop from normalised residual to psi of one fault that this psi can see."""
    p = noise.loop.outputs // noise.count
    A, B, C = noise.loop.A, noise.loop.B[:, :p], noise.loop.C[p * fault : p * (fault + 1)]
    seen = np.abs(C).sum(axis=0) > 0
    while True:
        more = seen | (np.abs(A[seen]).sum(axis=0) > 0)
        if more.sum() == seen.sum():
            return A[np.ix_(seen, seen)], B[seen], C[:, seen]
        seen = more


def _mean_step(A: Array, B: Array, C: Array, samples: int) -> float:
    """Return ``E I^(3/2) / E I`` for the information ``I = sum |psi|^2`` of so many samples, taken as Gamma distributed."""
    P = solve_discrete_lyapunov(A, B @ B.T) if len(A) else np.zeros((0, 0))
    mean = samples * float(np.trace(C @ P @ C.T))
    if not mean > 0:
        return 0.0
    variance, later = 0.0, C @ P
    for lag in range(samples):
        variance += (1 + (lag > 0)) * (samples - lag) * 2 * float(np.sum((later @ C.T) ** 2))
        later = later @ A.T
    k = mean**2 / variance
    return math.sqrt(mean) * math.exp(math.lgamma(k + 1.5) - math.lgamma(k) - 1.5 * math.log(k))
