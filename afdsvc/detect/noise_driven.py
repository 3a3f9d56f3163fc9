"""How the loop's own noise, and a burst, drive the regressors of the faults: information per sample and its bias.

Written in innovations (``xh+ = A xh + B u + Kp r, y = C xh + D u + r``) and closed with J_K, the healthy loop is a
stable system from ``[r, alpha]`` to all psi_i. H_i is its part from normalised r to normalised psi_i. Per sample the
noise brings the information ``int tr(H_i* H_i) dw / 2 pi`` about theta_i, a burst adds ``sum |s|^2 / 2`` over its
lines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.regressors import Regressors, regressors
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import star
from afdsvc.lti.statespace import Array, ComplexArray, StateSpace

_GRID = 2048  # frequencies up to Nyquist, more when the loop rings long
_FINEST = 1 << 15


@dataclass(frozen=True, slots=True, eq=False)
class NoiseDriven:
    """Per-sample cumulants of ``b_i = sum psi_i' e`` and ``G_i = sum psi_i' psi_i`` without a fault, each ``(K,)``.

    ``gram (K, K)`` is the mean of ``sum psi_i' psi_j``, ``passive`` its diagonal (the information), ``skew`` half the
    covariance of b and G, ``third`` the joint cumulant of b, b and G, ``spread`` the variance of G.
    """

    loop: StateSpace
    faults: int
    gram: Array
    skew: Array
    third: Array
    spread: Array

    @property
    def passive(self) -> Array:
        """Information per sample that the loop's noise brings about every fault, ``(K,)``."""
        return np.asarray(np.diag(self.gram))

    def excited(self, burst: Burst) -> tuple[Array, Array]:
        """Return what a burst's lines add per sample to information and skew, both ``(K,)``."""
        active, skew = np.zeros(self.faults), np.zeros(self.faults)
        if not burst.lines:
            return active, skew
        H, S = _split(self.loop, self.faults, np.array([line.omega for line in burst.lines]))
        for k, line in enumerate(burst.lines):
            s = line.amplitude * S[k, :, :, line.input]
            active += 0.5 * np.sum(np.abs(s) ** 2, axis=1)
            skew += 0.5 * np.real(np.einsum("ip,ipq,iq->i", s.conj(), H[k], s))
        return active, skew

    def signed_root(self, samples: int, burst: Burst | None = None) -> tuple[Array, Array]:
        """Return mean and standard deviation of every ``-b_i / sqrt(G_i)`` without a fault, to order 1/samples.

        A signed root of the likelihood ratio is normal to order ``samples^-3/2`` once these two are corrected
        (T. J. DiCiccio and M. A. Martin, *Biometrika* 80, 1993). Faults without information get 0 and 1.
        """
        active, skew = self.excited(burst) if burst is not None else (np.zeros(self.faults), np.zeros(self.faults))
        information = samples * (self.passive + active)
        safe = np.where(information > 0, information, np.inf)
        mean = samples * (self.skew + skew) / safe**1.5
        variance = 1 + samples * (self.spread - self.third) / safe**2 + 7 * mean**2
        return mean, np.sqrt(np.clip(variance, 0.25, 4.0))


def noise_driven(problem: DetectionProblem, filters: Regressors | None = None) -> NoiseDriven:
    """Return the noise-driven part of all regressors of a problem."""
    f = regressors(problem) if filters is None else filters
    loop = _loop(problem, f)
    K = len(f.names)
    slowest = float(np.abs(loop.poles()).max(initial=0.0))
    n = int(min(_FINEST, max(_GRID, 16 / max(1 - slowest, 1e-9))))
    omega: Array = (np.arange(n, dtype=np.float64) + 0.5) * (np.pi / (n * loop.dt))
    H, _ = _split(loop, K, omega)
    C, Q = np.swapaxes(H.conj(), -1, -2) @ H, (H + np.swapaxes(H.conj(), -1, -2)) / 2

    def integral(kernel: ComplexArray) -> Array:
        return np.asarray(np.mean(np.trace(kernel, axis1=2, axis2=3).real, axis=0))

    gram = np.mean(np.einsum("wipq,wjpq->wij", H.conj(), H).real, axis=0)
    return NoiseDriven(loop, K, gram, integral(Q @ C), 8 * integral(Q @ Q @ C), 2 * integral(C @ C))


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
    B = np.vstack([np.hstack([f.Kp, g.B]), *(np.hstack([np.zeros((n, p)), f.Bw[i] @ f.Dzu[i]]) for i in range(K))])
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
