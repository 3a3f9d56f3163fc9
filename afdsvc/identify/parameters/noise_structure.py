"""From parameters to the one-step predictor, with exact derivatives of every step on the way.

    theta -> (A, B, C, D) continuous -> sampled (zero-order hold) -> Riccati equation -> predictor (A - K C, [B - K D,
    K], C, D)

Noise parameters are logarithms of standard deviations: one per output, one per direction of process noise. The matrices
are differentiated by central differences of the user's function (exact for polynomials up to degree two), sampling by
the matrix exponential of a block-triangular matrix, the Riccati equation implicitly: its derivative solves a Lyapunov
equation with the closed-loop matrix A - K C.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from afdsvc.errors import IllConditioned
from afdsvc.identify.parameters.structure import Structure
from afdsvc.identify.settings import SETTINGS
from afdsvc.lti.riccati import riccati
from afdsvc.lti.scaling import state_scaling
from afdsvc.lti.stability import eigenvalues, worst_pole
from afdsvc.lti.statespace import Array, StateSpace


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Derivatives of a system's matrices, each stacked along a first axis of length q (number of parameters)."""

    A: Array
    B: Array
    C: Array
    D: Array


@dataclass(frozen=True, slots=True, eq=False)
class PredictorPoint:
    """A predictor at one point of parameter space: inputs ``[u, y]``, with the covariance of its errors, and all
    slopes.

    ``plant`` is the sampled plant, ``gain`` its Kalman gain.
    """

    predictor: StateSpace
    slopes: Slopes
    covariance: Array
    covariance_slopes: Array
    plant: StateSpace
    gain: Array


def plant_point(structure: Structure, theta: Array, dt: float) -> tuple[StateSpace, Slopes]:
    """Return the sampled plant at the parameters and its slopes with respect to them."""
    nominal = structure.build(theta)
    steps = 1e-4 * structure.scales
    ahead = [structure.build(theta + step) for step in np.diag(steps)]
    behind = [structure.build(theta - step) for step in np.diag(steps)]
    slopes = Slopes(
        *(
            np.stack([(getattr(a, k) - getattr(b, k)) / (2 * h) for a, b, h in zip(ahead, behind, steps, strict=True)])
            for k in ("A", "B", "C", "D")
        )
    )
    return (nominal, slopes) if nominal.discrete else _sampled(nominal, slopes, dt)


def predictor_point(structure: Structure, theta: Array, noise: Array, dt: float) -> PredictorPoint:
    """Return the predictor and its slopes; ``noise`` are log standard deviations, outputs first, then process
    directions.

    Raises `IllConditioned` when the Riccati equation has no stabilising solution there.
    """
    plant, slopes = plant_point(structure, theta, dt)
    p, q = plant.outputs, len(theta)
    E = structure.process_inputs if structure.process_inputs is not None else np.zeros((plant.order, 0))
    variances = np.exp(2 * noise)
    R, Q = np.diag(variances[:p]), (E * variances[p:]) @ E.T
    full = _with_noise(slopes, len(noise))
    dQ, dR = _noise_slopes(E, variances, p, q)
    P, K = _filter(plant, Q, R)
    Xi = plant.C @ P @ plant.C.T + R
    dK, dXi = _filter_slopes(plant, full, P, K, Xi, dQ, dR)
    predictor = StateSpace(
        plant.A - K @ plant.C,
        np.hstack([plant.B - K @ plant.D, K]),
        plant.C,
        np.hstack([plant.D, np.zeros((p, p))]),
        dt,
    )
    moved = Slopes(
        full.A - dK @ plant.C - K @ full.C,
        np.concatenate([full.B - dK @ plant.D - K @ full.D, dK], axis=2),
        full.C,
        np.concatenate([full.D, np.zeros((len(full.D), p, p))], axis=2),
    )
    return PredictorPoint(predictor, moved, Xi, dXi, plant, K)


def _sampled(system: StateSpace, slopes: Slopes, dt: float) -> tuple[StateSpace, Slopes]:
    """Sample with inputs held, and differentiate: expm([M E; 0 M]) holds exp(M) and its derivative towards E."""
    n, m = system.B.shape
    require_samplable(system, dt)
    t = state_scaling(system.A)
    there, back = t[None, :] / t[:, None], t[:, None] / t[None, :]
    M = np.zeros((n + m, n + m))
    M[:n] = np.hstack([system.A * there, system.B / t[:, None]]) * dt
    E = np.zeros((len(slopes.A), n + m, n + m))
    E[:, :n] = np.concatenate([slopes.A * there, slopes.B / t[:, None]], axis=2) * dt
    zero = np.zeros_like(E)
    blocks = np.concatenate(
        [
            np.concatenate([np.broadcast_to(M, E.shape), E], axis=2),
            np.concatenate([zero, np.broadcast_to(M, E.shape)], axis=2),
        ],
        axis=1,
    )
    step, moved = linalg.expm(M), linalg.expm(blocks)[:, : n + m, n + m :] if len(E) else zero
    plant = StateSpace(step[:n, :n] * back, step[:n, n:] * t[:, None], system.C, system.D, dt)
    return plant, Slopes(moved[:, :n, :n] * back, moved[:, :n, n:] * t[:, None], slopes.C, slopes.D)


def require_samplable(system: StateSpace, dt: float) -> None:
    """Raise `IllConditioned` for a continuous system that grows or turns beyond all measure within one sample."""
    rate = float(np.abs(eigenvalues(system.A)).max(initial=0.0)) * dt if np.isfinite(system.A).all() else float("inf")
    if not rate < SETTINGS.largest_rate:
        raise IllConditioned(f"the plant has a pole of size {rate:.2g} per sample; expected below {SETTINGS.largest_rate:.2g}")


def _with_noise(slopes: Slopes, count: int) -> Slopes:
    """Append noise parameters, on which the plant does not depend."""
    return Slopes(
        *(np.concatenate([s, np.zeros((count, *s.shape[1:]))]) for s in (slopes.A, slopes.B, slopes.C, slopes.D))
    )


def _noise_slopes(E: Array, variances: Array, p: int, q: int) -> tuple[Array, Array]:
    """Return the slopes of Q and R with respect to all parameters."""
    n, count = E.shape[0], len(variances)
    dQ, dR = np.zeros((q + count, n, n)), np.zeros((q + count, p, p))
    for i in range(p):
        dR[q + i, i, i] = 2 * variances[i]
    for j in range(E.shape[1]):
        dQ[q + p + j] = 2 * variances[p + j] * np.outer(E[:, j], E[:, j])
    return dQ, dR


def _filter(plant: StateSpace, Q: Array, R: Array) -> tuple[Array, Array]:
    if not Q.any() and worst_pole(plant.A, plant.dt)[1] > 1e-9:
        return np.zeros_like(Q), np.zeros((plant.order, plant.outputs))  # output noise only, stable plant
    P, F = riccati(plant.A.T, plant.C.T, Q, R, np.zeros((plant.order, plant.outputs)), plant.dt)
    return P, -F.T


def _filter_slopes(
    plant: StateSpace, slopes: Slopes, P: Array, K: Array, Xi: Array, dQ: Array, dR: Array
) -> tuple[Array, Array]:
    """Differentiate ``P = A P A' + Q - K Xi K'`` and ``K = A P C' Xi^-1``; K is optimal, so its own change drops out of
    P."""
    A, C, n = plant.A, plant.C, plant.order
    closed = A - K @ C
    forced = (slopes.A - K @ slopes.C) @ P @ closed.T
    right = forced + forced.transpose(0, 2, 1) + dQ + K @ dR @ K.T
    if P.any() or dQ.any():
        operator = np.eye(n * n) - np.kron(closed, closed)
        dP = np.linalg.solve(operator, right.reshape(len(right), n * n).T).T.reshape(right.shape)
    else:
        dP = np.zeros_like(right)
    through = slopes.C @ P @ C.T
    dXi = through + through.transpose(0, 2, 1) + C @ dP @ C.T + dR
    cross = slopes.A @ P @ C.T + A @ dP @ C.T + A @ P @ slopes.C.transpose(0, 2, 1) - K @ dXi
    dK = np.linalg.solve(Xi, cross.transpose(0, 2, 1)).transpose(0, 2, 1)
    return np.asarray(dK, dtype=np.float64), dXi
