"""Ten machines in closed loop with an observer controller, drawn and simulated without any code of the package.

    x+ = A x + B (1 + theta_a) u + w        y = (1 + theta_s) (C x + D (1 + theta_a) u) + v
    h+ = A h + B u - L beta                 u = F h + alpha        beta = y - ref - C h - D u

w and v are white with the stated covariances. Actuator and sensor gains may change from sample to sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.linalg import solve_discrete_are


@dataclass(frozen=True)
class TrueMachine:
    """One machine: plant, gains of its observer controller, covariances of process noise ``Q (n, n)`` and sensor noise ``R (p, p)``."""

    name: str
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    F: np.ndarray
    L: np.ndarray
    Q: np.ndarray
    R: np.ndarray
    dt: float = 1e-3

    @property
    def shape(self) -> tuple[int, int, int]:
        """States, inputs, outputs."""
        return len(self.A), self.B.shape[1], len(self.C)

    def run(self, rng: np.random.Generator, alpha: np.ndarray, loss: np.ndarray | None = None, ref: np.ndarray | None = None,
            noisier: np.ndarray | float = 1.0, plant: tuple[np.ndarray, np.ndarray] | None = None) -> dict[str, np.ndarray]:
        """Return u, y, alpha, beta of a run from rest; ``loss (n, m + p)`` are severities of actuators, then sensors, ``ref (n, p)``
        references; ``noisier`` multiplies both noises, sample by sample if it is an array. ``plant`` are the A and B of the machine where
        they are not those that the controller was made for."""
        n, (_, m, p) = len(alpha), self.shape
        scale = np.broadcast_to(np.asarray(noisier, dtype=float), (n,))[:, None]
        w, v = (scale * rng.standard_normal((n, len(cov))) @ _root(cov).T for cov in (self.Q, self.R))
        gains = 1 + (np.zeros((n, m + p)) if loss is None else np.broadcast_to(np.asarray(loss, dtype=float), (n, m + p)))
        known = np.zeros((n, p)) if ref is None else ref
        made, controller = plant or (self.A, self.B), (self.A, self.B, self.C, self.D, self.F, self.L)
        u, y, beta = _run(*made, *controller, w, v, np.ascontiguousarray(gains), alpha, known)
        return {"u": u, "y": y, "alpha": alpha, "beta": beta, "ref": known}

    def spread(self) -> tuple[np.ndarray, np.ndarray]:
        """Return standard deviations of measured outputs and inputs in the healthy loop, from its stationary covariance by doubling."""
        n, m, p = self.shape
        A = np.block([[self.A, self.B @ self.F], [-self.L @ self.C, self.A + self.B @ self.F + self.L @ self.C]])
        G = np.block([[np.eye(n), np.zeros((n, p))], [np.zeros((n, n)), -self.L]])
        P = G @ np.block([[self.Q, np.zeros((n, p))], [np.zeros((p, n)), self.R]]) @ G.T
        power = A
        for _ in range(60):
            P, power = P + power @ P @ power.T, power @ power
        Cy = np.hstack([self.C, self.D @ self.F])
        Cu = np.hstack([np.zeros((m, n)), self.F])
        return np.sqrt(np.diag(Cy @ P @ Cy.T + self.R)), np.sqrt(np.diag(Cu @ P @ Cu.T))

    def scaled(self, states: np.ndarray, inputs: np.ndarray, outputs: np.ndarray) -> TrueMachine:
        """Return the machine in other units: numbers of its states, inputs and outputs are multiplied by these."""
        s, i, o = (np.asarray(v, dtype=float) for v in (states, inputs, outputs))
        return replace(
            self, A=s[:, None] * self.A / s, B=s[:, None] * self.B / i, C=o[:, None] * self.C / s, D=o[:, None] * self.D / i,
            F=i[:, None] * self.F / s, L=s[:, None] * self.L / o, Q=s[:, None] * self.Q * s, R=o[:, None] * self.R * o,
        )


def machines() -> tuple[TrueMachine, ...]:
    """Return the ten machines of the page."""
    calm = _drawn("tiny units", 9, 4, 2, 2, (0.5, 0.97), 0.05)
    loud = _drawn("huge units", 10, 3, 1, 1, (0.6, 0.95), 0.05)
    return (
        _drawn("order 2, output noise", 1, 2, 1, 1, (0.8, 0.95), 0.0),
        _drawn("order 8, process noise small", 2, 8, 2, 2, (0.4, 0.97), 0.02),
        _drawn("process noise large", 3, 4, 2, 2, (0.6, 0.98), 3.0),
        _drawn("unstable", 4, 3, 1, 1, (0.7, 0.9), 0.3, first=1.03),
        _drawn("integrating", 5, 3, 1, 2, (0.7, 0.9), 0.05, first=1.0),
        _drawn("direct feedthrough", 6, 4, 2, 2, (0.6, 0.95), 0.1, through=0.5),
        _drawn("one input, three outputs", 7, 5, 1, 3, (0.6, 0.95), 0.1),
        _drawn("three inputs, one output", 8, 5, 3, 1, (0.6, 0.95), 0.1),
        replace(calm.scaled(np.full(4, 1e-9), np.full(2, 1e-6), np.full(2, 1e-12)), name=calm.name),
        replace(loud.scaled(np.full(3, 1e9), np.full(1, 1e6), np.full(1, 1e12)), name=loud.name),
    )


def _drawn(
    name: str, seed: int, n: int, m: int, p: int, radii: tuple[float, float], shaken: float, first: float | None = None,
    through: float = 0.0,
) -> TrueMachine:
    """Draw a machine; ``shaken`` is the standard deviation that process noise alone makes at the output of the controlled plant, in
    those of the sensors, whose noises are correlated."""
    rng = np.random.default_rng(seed)
    A = _modes(rng, n, radii, first)
    T = np.linalg.qr(rng.standard_normal((n, n)))[0]
    A, B, C = T @ A @ T.T, rng.standard_normal((n, m)), rng.standard_normal((p, n))
    S = _correlated(rng, p)
    F = _gain(A, B, C.T @ C, np.eye(m))
    G = rng.standard_normal((n, n))
    Q = G @ G.T / n
    L = _gain(A.T, C.T, Q + 0.1 * np.eye(n), S).T  # an observer, but not the Kalman filter of this noise
    P, closed = Q, A + B @ F
    for _ in range(60):
        P, closed = P + closed @ P @ closed.T, closed @ closed
    Q = Q * shaken**2 / np.mean(np.diag(C @ P @ C.T))
    return TrueMachine(name, A, B, C, through * rng.standard_normal((p, m)), F, L, Q, S)


def _modes(rng: np.random.Generator, n: int, radii: Sequence[float], first: float | None) -> np.ndarray:
    A, k = np.zeros((n, n)), 0
    if first is not None or n % 2:
        A[0, 0], k = rng.uniform(*radii) if first is None else first, 1
    while k < n:
        r, w = rng.uniform(*radii), rng.uniform(0.05, 0.8)
        if n - k == 1:
            A[k, k], k = r, k + 1
        else:
            A[k : k + 2, k : k + 2], k = r * np.array([[np.cos(w), np.sin(w)], [-np.sin(w), np.cos(w)]]), k + 2
    return A


def _correlated(rng: np.random.Generator, p: int) -> np.ndarray:
    root = np.eye(p) + 0.4 * np.tril(rng.standard_normal((p, p)), -1)
    sd = rng.uniform(0.5, 2.0, p)
    S = root @ root.T
    return np.asarray(S / np.sqrt(np.outer(np.diag(S), np.diag(S))) * np.outer(sd, sd))


def _gain(A: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray) -> np.ndarray:
    X = solve_discrete_are(A, B, Q, R)
    return np.asarray(-np.linalg.solve(R + B.T @ X @ B, B.T @ X @ A))


def _root(cov: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(cov)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


@njit(cache=True)
def _run(A1, B1, A, B, C, D, F, L, w, v, gains, alpha, ref):  # type: ignore[no-untyped-def]
    n, m, p, T = A.shape[0], B.shape[1], C.shape[0], w.shape[0]
    x, h = np.zeros((2, n)), np.zeros((2, n))
    u, y, beta, acting, expected = alpha.copy(), np.zeros((T, p)), np.zeros((T, p)), np.zeros(m), np.zeros(p)
    for k in range(T):
        now, then = k % 2, 1 - k % 2
        _add(u[k], F, h[now], 1.0)
        acting[:] = gains[k, :m] * u[k]
        _add(y[k], C, x[now], 1.0)
        _add(y[k], D, acting, 1.0)
        y[k] = gains[k, m:] * y[k] + v[k]
        expected[:] = ref[k]
        _add(expected, C, h[now], 1.0)
        _add(expected, D, u[k], 1.0)
        beta[k] = y[k] - expected
        x[then], h[then] = w[k], 0.0
        _add(x[then], A1, x[now], 1.0)
        _add(x[then], B1, acting, 1.0)
        _add(h[then], A, h[now], 1.0)
        _add(h[then], B, u[k], 1.0)
        _add(h[then], L, beta[k], -1.0)
    return u, y, beta


@njit(cache=True)
def _add(out, M, v, factor):  # type: ignore[no-untyped-def]
    """Add ``factor M v``, in loops: calls of BLAS cost several times as much for matrices this small."""
    for i in range(M.shape[0]):
        for j in range(M.shape[1]):
            out[i] += factor * M[i, j] * v[j]
