"""Subspace identification in open loop: PO- and PI-MOESP, N4SID and CVA from one compressed factor.

With future inputs Uf, instruments Z and future outputs Yf (s block rows each), the triangular factor of [Uf Z Yf] holds
everything (Verhaegen and Dewilde 1992; Van Overschee and De Moor 1996; Larimore 1990):

    PO-MOESP  Z = [Up Yp],  column space of R23^T
    PI-MOESP  Z = Up only: the noise may have any colour, the horizon must cover the slowest time constant
    N4SID     oblique projection  R23^T R22^-T [R12; R22]^T
    CVA       (R23^T R23 + R33^T R33)^-1/2 R23^T, whose singular values are canonical correlations

A and C follow from shift invariance, B and D from linear regression on the whole recordings (`input_matrices`), the
noise model from the residuals of the state equation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import linalg

from afdsvc.dataset.arrays import InputOutputData, scale_recordings, scales
from afdsvc.errors import BadInput
from afdsvc.identify.numerics.compression import Route, compress, lags, triangle
from afdsvc.identify.numerics.innovations_form import InnovationsForm, noise_model
from afdsvc.identify.numerics.input_matrices import regress_input_matrices
from afdsvc.lti.statespace import Array, StateSpace

#: Largest modulus of a pole that the guarantee leaves on short recordings; on long ones it is nearer to one (`realise`).
LIMIT = 0.9999


def stable_transition(Gamma: Array, outputs: int, limit: float = LIMIT) -> Array:
    """Return A with spectral radius at most ``limit`` from an observability matrix ``Gamma (s p, n)``.

    The least-squares solution of ``Gamma[:-p] A = Gamma[p:]`` is kept when it is stable; otherwise the smallest ridge c
    in ``A = (G'G + c I)^-1 G' Gamma[p:]`` that makes it so is found by bisection (Van Gestel, Suykens, Van Dooren and
    De Moor, 2001). The modulus falls continuously to 0 as c grows, so a solution always exists.
    """
    before, after = Gamma[:-outputs], Gamma[outputs:]
    plain = linalg.lstsq(before, after)[0]
    if _radius(plain) <= limit:
        return np.asarray(plain)
    square, cross = before.T @ before, before.T @ after
    size = float(np.trace(square)) / len(square)

    def ridge(log_c: float) -> Array:
        return np.asarray(linalg.solve(square + size * 10.0**log_c * np.eye(len(square)), cross, assume_a="pos"))

    low, high = -16.0, 6.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if _radius(ridge(middle)) <= limit else (middle, high)
    return ridge(high)


def _radius(A: Array) -> float:
    return float(np.abs(np.linalg.eigvals(A)).max())


Weighting = Literal["po-moesp", "pi-moesp", "n4sid", "cva"]
WEIGHTINGS: tuple[Weighting, ...] = ("po-moesp", "pi-moesp", "n4sid", "cva")


@dataclass(frozen=True, slots=True, eq=False)
class Subspace:
    """What the data say before an order is chosen.

    ``singular_values (s p,)`` fall where the dynamics end; ``basis (s p, s p)`` spans the extended observability matrix
    column by column (weighting undone), ``state_map (s p, s (m+p))`` takes past ``[Up, Yp]`` to the state in that
    basis. ``factor`` is the compressed data, ``scales`` the signals' root mean squares, ``windows`` their number.
    """

    weighting: Weighting
    horizon: int
    singular_values: Array
    basis: Array
    state_map: Array
    factor: Array
    u_scale: Array
    y_scale: Array
    windows: int
    recordings: tuple[InputOutputData, ...]


def decompose(
    recordings: Sequence[InputOutputData], horizon: int, weighting: Weighting = "po-moesp", route: Route = "auto"
) -> Subspace:
    """Return the singular value decomposition for one horizon s (block rows of past and of future).

    Raises `BadInput` for an unknown weighting, a horizon below 2 or recordings too short for it.
    """
    _check(weighting, horizon)
    u_scale, y_scale = scales(recordings)
    relative = scale_recordings(recordings, u_scale, y_scale)
    factor = compress(relative, 2 * horizon, route)
    windows = sum(max(0, len(r) - 2 * horizon + 1) for r in relative)
    return _decompose_factor(factor, windows, tuple(relative), horizon, weighting, (u_scale, y_scale))


def _decompose_factor(
    factor: Array,
    windows: int,
    recordings: tuple[InputOutputData, ...],
    horizon: int,
    weighting: Weighting,
    scale: tuple[Array, Array],
) -> Subspace:
    """Return the decomposition from a factor that is already compressed (windows of ``2 horizon`` lags)."""
    m, p = recordings[0].u.shape[1], recordings[0].y.shape[1]
    basis, values, state_map = _project(factor, m, p, horizon, weighting)
    return Subspace(weighting, horizon, values, basis, state_map, factor, *scale, windows, recordings)


def realise(subspace: Subspace, order: int, stable: bool = False, feedthrough: bool = True) -> InnovationsForm:
    """Return the model of one order in the signals' own units, with its noise model.

    ``stable`` guarantees a stable A (a little biased when it has to act). Raises `BadInput` when the order exceeds what
    the horizon can show.
    """
    s, p = subspace.horizon, len(subspace.y_scale)
    if not 1 <= order <= (s - 1) * p:
        raise BadInput(f"order {order} with horizon {s} and {p} outputs; expected an order from 1 to {(s - 1) * p}")
    Gamma = subspace.basis[:, :order]
    C = Gamma[:p]
    limit = max(LIMIT, 1 - 0.1 / max(subspace.windows, 1))  # a mode this slow loses a tenth over the recordings: no data tell it from an integrator
    A = stable_transition(Gamma, p, limit) if stable else linalg.lstsq(Gamma[:-p], Gamma[p:])[0]
    gain, covariance = _noise(subspace, A, C, order)
    # An unstable A cannot be simulated: there B and D are found through the stable predictor instead.
    predictor = gain if np.abs(np.linalg.eigvals(A)).max() >= 1 else None
    B, D = regress_input_matrices(A, C, subspace.recordings, predictor, feedthrough)
    return _in_units(InnovationsForm(StateSpace(A, B, C, D, subspace.recordings[0].dt), gain, covariance), subspace)


def _check(weighting: str, horizon: int) -> None:
    if weighting not in WEIGHTINGS:
        raise BadInput(f"subspace weighting '{weighting}'; expected one of {', '.join(WEIGHTINGS)}")
    if horizon < 2:
        raise BadInput(f"horizon {horizon}; expected at least 2 block rows")


def _project(factor: Array, m: int, p: int, s: int, weighting: Weighting) -> tuple[Array, Array, Array]:
    """Return the observability basis, its singular values and the map from the past ``[Up, Yp]`` to the state."""
    width, inputs, outputs = m + p, range(m), range(m, m + p)
    past_u, past_y = lags(width, inputs, 0, s), lags(width, outputs, 0, s)
    future_u, future_y = lags(width, inputs, s, 2 * s), lags(width, outputs, s, 2 * s)
    past = past_u if weighting == "pi-moesp" else np.concatenate([past_u, past_y])
    R = triangle(factor[:, np.concatenate([future_u, past, future_y])])
    a, b = len(future_u), len(future_u) + len(past)
    R22, R23, R33 = R[a:b, a:b], R[a:b, b:], R[b:, b:]
    oblique = linalg.lstsq(R22, R23, cond=1e-12)[0].T
    target = oblique @ np.hstack([R[:a, a:b].T, R22.T]) if weighting == "n4sid" else R23.T
    weight = linalg.cholesky(_jitter(R23.T @ R23 + R33.T @ R33), lower=True) if weighting == "cva" else None
    left, values, _ = linalg.svd(
        target if weight is None else linalg.solve_triangular(weight, target, lower=True), full_matrices=False
    )
    left = left * np.sqrt(values)
    basis = left if weight is None else weight @ left
    # x = Gamma^+ (oblique projection); for PI-MOESP the past outputs carry no weight.
    inverse = (left / np.where(values > 0, values, 1.0)).T
    inverse = inverse if weight is None else linalg.solve_triangular(weight, inverse.T, lower=True, trans="T").T
    state_map = inverse @ oblique
    if weighting == "pi-moesp":
        state_map = np.hstack([state_map, np.zeros((len(state_map), s * p))])
    return np.asarray(basis), np.asarray(values), np.asarray(state_map)


def _noise(subspace: Subspace, A: Array, C: Array, order: int) -> tuple[Array, Array]:
    """Return gain and covariance from the residuals of the state equation, all inside the compressed factor."""
    m, p, s = len(subspace.u_scale), len(subspace.y_scale), subspace.horizon
    width, inputs, outputs = m + p, range(m), range(m, m + p)
    T = subspace.state_map[:order]

    def state(shift: int) -> Array:
        columns = np.concatenate([lags(width, inputs, shift, s + shift), lags(width, outputs, shift, s + shift)])
        return np.asarray(subspace.factor[:, columns] @ T.T)

    now, then = state(0), state(1)
    u, y = (subspace.factor[:, lags(width, side, s, s + 1)] for side in (inputs, outputs))
    known = np.hstack([now, u])
    fitted = known @ linalg.lstsq(known, np.hstack([then, y]))[0]
    errors = (np.hstack([then, y]) - fitted) / np.sqrt(subspace.windows)
    if subspace.weighting == "pi-moesp":  # the state is known from inputs alone: the noise keeps its colour
        return np.zeros((order, p)), np.asarray(errors[:, order:].T @ errors[:, order:])
    return noise_model(A, C, errors[:, :order], errors[:, order:])


def _jitter(gram: Array) -> Array:
    return np.asarray(gram + 1e-13 * np.trace(gram) / len(gram) * np.eye(len(gram)))


def _in_units(model: InnovationsForm, subspace: Subspace) -> InnovationsForm:
    u, y, s = subspace.u_scale, subspace.y_scale, model.system
    system = StateSpace(s.A, s.B / u, y[:, None] * s.C, y[:, None] * s.D / u, s.dt)
    return InnovationsForm(system, model.gain / y, model.covariance * np.outer(y, y))
