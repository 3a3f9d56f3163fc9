"""White residuals: the innovations of a plant with process and output noise, from measurements or from beta.

Model ``x+ = A x + B u + w``, ``y = C x + D u + v`` with ``cov [w; v] = [Qw Sw; Sw' Rv]`` (intensities in continuous
time). One Riccati equation covers every case: a stable plant with output noise only gives ``r = y - G u``, an unstable
one its spectral factor (unstable poles mirrored), process noise the Kalman predictor. The innovations do not depend on
the controller nor on the choice of coprime factors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from afdsvc.errors import BadInput, IllConditioned
from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.riccati import covariance, cross_covariance, riccati
from afdsvc.lti.scaling import state_scaling
from afdsvc.lti.stabilise import minimum_energy_regulator
from afdsvc.lti.stability import describe_pole, trim, worst_pole
from afdsvc.lti.statespace import Array, StateSpace


@dataclass(frozen=True, slots=True, eq=False)
class Innovations:
    """The white residual of a plant.

    ``filter`` maps ``[y; u]`` to r, shape ``(p, p + m)``; ``covariance (p, p)`` is that of r (an intensity in
    continuous time); ``gain (n, p)`` is the predictor gain in ``x^+ = A x^ + B u + gain r``; ``state_covariance (n,
    n)`` that of the prediction error; ``regularised`` the share of process noise that had to be added (0 normally).
    """

    filter: StateSpace
    covariance: Array
    gain: Array
    state_covariance: Array
    regularised: float = 0.0


def innovations(
    plant: StateSpace,
    output_cov: ArrayLike,
    process_cov: ArrayLike | None = None,
    cross_cov: ArrayLike | None = None,
    regularise: float = 0.0,
) -> Innovations:
    """Return the innovations filter of a plant; shapes ``output_cov (p, p)``, ``process_cov (n, n)``, ``cross_cov (n,
    p)``.

    A mode on the border of stability that no process noise reaches has no steady innovations: `IllConditioned` names
    the pole. Give ``process_cov``, or allow ``regularise`` (for example 1e-6): then that share of the output noise,
    carried back to every state, is added as process noise; r is white to about the square root of that share.
    """
    n = plant.order
    R, Q = covariance("output_cov", output_cov, plant.outputs), np.zeros((n, n))
    if process_cov is not None:
        Q = covariance("process_cov", process_cov, n, definite=False)
    S = np.zeros((n, plant.outputs)) if cross_cov is None else cross_covariance(cross_cov, Q, R)
    if regularise:
        Q = Q + regularise * _state_noise(plant, R)
    P, gain = _predictor(plant, Q, R, S)
    Xi = plant.C @ P @ plant.C.T + R if plant.discrete else R
    A = plant.A - gain @ plant.C
    filter_ = StateSpace(
        A,
        np.hstack([gain, plant.B - gain @ plant.D]),
        -plant.C,
        np.hstack([np.eye(plant.outputs), -plant.D]),
        plant.dt,
    )
    return Innovations(filter_, (Xi + Xi.T) / 2, gain, P, regularise)


def _predictor(plant: StateSpace, Q: Array, R: Array, S: Array) -> tuple[Array, Array]:
    """Return the error covariance and the predictor gain ``(A P C' + S) Xi^-1``."""
    pole, margin = worst_pole(plant.A, plant.dt)
    try:
        if not Q.any() and not S.any():
            _refuse_border(plant)
            return _without_process_noise(plant, R)
        return _with_process_noise(plant, Q, R, S)
    except IllConditioned as failed:
        raise IllConditioned(
            f"the plant with the pole {describe_pole(pole, plant.dt)} has no steady innovations for this noise: {failed}"
        ) from failed


def _with_process_noise(plant: StateSpace, Q: Array, R: Array, S: Array) -> tuple[Array, Array]:
    """Return the solution of the Riccati equation, solved in units in which sensor noise and what states do at the outputs are of size one."""
    whitener = np.linalg.inv(np.linalg.cholesky(R))
    t = state_scaling(plant.A)
    t = t / max(float(np.linalg.norm(whitener @ plant.C * t[None, :])), 1e-300)
    A, C = plant.A * (t[None, :] / t[:, None]), whitener @ plant.C * t[None, :]
    unit = np.eye(len(R))
    P, F = riccati(A.T, C.T, Q / np.outer(t, t), unit, S @ whitener.T / t[:, None], plant.dt)
    return P * np.outer(t, t), t[:, None] * (-F.T @ whitener)


def _without_process_noise(plant: StateSpace, R: Array) -> tuple[Array, Array]:
    """Return the same for output noise alone: the spectral factor that mirrors the unstable poles, zero without any."""
    t = state_scaling(plant.A)
    A, C = plant.A * (t[None, :] / t[:, None]), plant.C * t[None, :]
    whitener = np.linalg.inv(np.linalg.cholesky(R))
    P, F = minimum_energy_regulator(A.T, (whitener @ C).T, plant.discrete)
    return P * (t[:, None] * t[None, :]), t[:, None] * (-F.T @ whitener)


def _refuse_border(plant: StateSpace) -> None:
    """Raise `IllConditioned` when a pole lies on the border of stability, where no process noise reaches it."""
    poles = plant.poles()
    distance = np.abs(1 - np.abs(poles)) if plant.discrete else np.abs(poles.real) / max(np.abs(poles).max(), 1e-300)
    if distance.min() > 1e-9:
        return
    pole = complex(poles[int(np.argmin(distance))])
    raise IllConditioned(
        f"the pole {pole:.6g} lies on the border of stability and no process noise reaches it; give process_cov, or allow "
        "regularise=1e-6 and accept residuals that are white only approximately"
    )


def _state_noise(plant: StateSpace, R: Array) -> Array:
    """Return the output noise carried back to the states, shape ``(n, n)``, consistent in units."""
    # Every state gets the variance whose smallest visible effect on an output equals that output's noise.
    relative = np.abs(plant.C) / np.sqrt(np.diag(R))[:, None]
    visible = _visibility(plant.A, relative)
    return np.diag(1 / np.square(visible))


def _visibility(A: Array, C: Array) -> Array:
    """Return how strongly each state shows in the (normalised) outputs within n steps of |A| balanced to size one."""
    size = max(float(np.abs(np.linalg.eigvals(A)).max()), np.finfo(float).tiny) if A.size else 1.0
    step, reach = np.abs(A) / size, C.copy()
    total = reach.max(axis=0) if C.size else np.zeros(A.shape[0])
    for _ in range(A.shape[0]):
        reach = reach @ step
        total = np.maximum(total, reach.max(axis=0))
    if not (total > 0).all():
        raise IllConditioned("a state is unobservable, so regularisation cannot scale its noise; remove it")
    return total


def whitening_filter(
    fact: Factorisation, output_cov: ArrayLike, process_cov: ArrayLike | None = None, regularise: float = 0.0,
    cross_cov: ArrayLike | None = None,
) -> tuple[StateSpace, Array]:
    """Return the stable filter ``W^-1`` from beta to the innovations r, and the covariance of r, shape ``(p, p)``.

    ``r = W^-1 beta`` is the same r that `innovations` makes from measurements, whatever factorisation beta belongs to.
    The order is at most n + n_K; for an observer ``W^-1 = (A - Kp C | Kp + L; -C | I)`` up to sign of the state.
    """
    plant, n, m = fact.plant, fact.plant.order, fact.plant.inputs
    nominal = innovations(plant, output_cov, process_cov, cross_cov, regularise)
    R, gain = fact.R, nominal.gain
    B_eff = plant.B - gain @ plant.D
    # e = (plant copy in R) - x^ : what alpha does cancels, what beta does remains.
    rest = slice(n, None)
    u_rest, y_rest, u_beta, y_beta = R.C[:m, rest], R.C[m:, rest], R.D[:m, m:], R.D[m:, m:]
    top = np.hstack([plant.A - gain @ plant.C, R.A[:n, rest] - B_eff @ u_rest - gain @ y_rest])
    bottom = np.hstack([np.zeros((R.order - n, n)), R.A[rest, rest]])
    B = np.vstack([R.B[:n, m:] - B_eff @ u_beta - gain @ y_beta, R.B[rest, m:]])
    C = np.hstack([plant.C, y_rest - plant.D @ u_rest])
    D = y_beta - plant.D @ u_beta
    _plant_copy(fact)
    return trim(StateSpace(np.vstack([top, bottom]), B, C, D, R.dt)), nominal.covariance


def _plant_copy(fact: Factorisation) -> None:
    """Raise `BadInput` unless the first states of R are a copy of the plant's, as all factorisations here make them."""
    n, m, plant, R = fact.plant.order, fact.plant.inputs, fact.plant, fact.R
    C_mismatch = R.C[m:, :n] - plant.D @ R.C[:m, :n] - plant.C
    A_mismatch = R.A[:n, :n] - plant.B @ R.C[:m, :n] - plant.A
    size = max(float(np.abs(plant.A).max(initial=0)), float(np.abs(plant.C).max(initial=0)), 1e-300)
    worst = max(np.abs(C_mismatch).max(initial=0), np.abs(A_mismatch).max(initial=0))
    if worst > 1e-9 * size:
        raise BadInput(
            f"the factorisation's R does not start with the plant's own states (mismatch {worst:.2g}); make it with "
            "the functions of afdsvc.lti.coprime"
        )
