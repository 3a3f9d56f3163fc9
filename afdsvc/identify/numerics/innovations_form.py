"""The innovations form: a plant with its noise model, and the one-step prediction it makes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from afdsvc.errors import IllConditioned
from afdsvc.lti.simulate import simulate
from afdsvc.lti.stability import describe_pole, is_stable, worst_pole
from afdsvc.lti.statespace import Array, StateSpace

#: Residual power of outputs of unit power below which a recording counts as free of noise.
NOISELESS = 1e-18
#: Size of a simulation beyond which nothing can be fitted to it: its square is still a number.
LARGEST = 1e150


@dataclass(frozen=True, slots=True, eq=False)
class InnovationsForm:
    """``x+ = A x + B u + K e``, ``y = C x + D u + e`` with white e.

    ``system`` is (A, B, C, D), ``gain`` K has shape ``(n, p)``, ``covariance`` that of e, shape ``(p, p)``.
    """

    system: StateSpace
    gain: Array
    covariance: Array

    def predictor(self) -> StateSpace:
        """Return the one-step predictor: inputs ``[u, y]``, output the predicted y."""
        s = self.system
        B = np.hstack([s.B - self.gain @ s.D, self.gain])
        D = np.hstack([s.D, np.zeros((s.outputs, s.outputs))])
        return StateSpace(s.A - self.gain @ s.C, B, s.C, D, s.dt)

    def errors(self, u: Array, y: Array) -> Array:
        """Return the prediction errors ``y - yhat``, shape ``(N, p)``, with the initial state that makes them least.

        An unstable predictor is replaced by the stable one of the same spectrum (`with_stable_predictor`); raises `IllConditioned` where there
        is none.
        """
        return fitted_errors(with_stable_predictor(self).predictor(), np.hstack([u, y]), y)


def fitted_errors(system: StateSpace, inputs: Array, outputs: Array) -> Array:
    """Return ``outputs - system(inputs)`` with the initial state fitted by least squares, shape ``(N, p)``.

    Raises `IllConditioned` where an unstable system leaves the range of numbers.
    """
    forced, _ = simulate(system, inputs)
    errors = outputs - forced
    if not float(np.abs(errors).max(initial=0.0)) < LARGEST:
        raise IllConditioned(f"the model has the pole {describe_pole(worst_pole(system.A, system.dt)[0], system.dt)}: it cannot run over {len(inputs)} samples")
    return np.asarray(errors - _initial_response(system, errors))


def _initial_response(system: StateSpace, errors: Array) -> Array:
    """Return the free response ``C A^k x0`` that fits the errors best, shape ``(N, p)``."""
    if not system.order:
        return np.zeros_like(errors)
    count = min(len(errors), _memory(system, len(errors)))
    rows, power = system.C[None], system.A
    while len(rows) < count:  # C A^k for twice as many k
        rows, power = np.concatenate([rows, rows @ power]), power @ power
    rows = rows[:count]
    flat = rows.reshape(-1, system.order)
    x0 = linalg.lstsq(flat, errors[:count].ravel())[0]
    response = np.zeros_like(errors)
    response[:count] = (flat @ x0).reshape(count, -1)
    return response


def with_stable_predictor(model: InnovationsForm) -> InnovationsForm:
    """Return the model with the gain of the Kalman filter for the same noise where ``A - K C`` is not stable.

    A regression gives any gain; the filter's has the same spectrum of ``y`` and a predictor that forgets its initial state.
    Raises `IllConditioned` when no such gain exists.
    """
    system = model.system
    if is_stable(system.A - model.gain @ system.C, system.dt):
        return model
    root = linalg.cholesky(model.covariance, lower=True).T
    return InnovationsForm(system, *noise_model(system.A, system.C, root @ model.gain.T, root))


def noise_model(A: Array, C: Array, state_errors: Array, output_errors: Array) -> tuple[Array, Array]:
    """Return the Kalman gain K and the innovations' covariance for residual factors of a subspace fit.

    ``state_errors (r, n)`` and ``output_errors (r, p)`` are the residuals of ``x+`` and ``y`` (already divided by the
    square root of the sample count): their cross products are Q, S, R. Raises `IllConditioned` when no stabilising
    solution exists.
    """
    p = C.shape[0]
    level = float((output_errors**2).sum()) / p
    if level < NOISELESS:  # nothing but rounding: a Kalman filter for it would be arbitrary
        if np.abs(np.linalg.eigvals(A)).max() < 1:
            return np.zeros((len(A), p)), np.eye(p) * level
        state_errors, output_errors, level = np.eye(len(A), len(A)), np.eye(len(A), p), NOISELESS
    Q, S, R = (product / level for product in _products(state_errors, output_errors))
    try:
        P = linalg.solve_discrete_are(A.T, C.T, Q, R + 1e-12 * np.eye(p), s=S)
    except (linalg.LinAlgError, ValueError) as error:
        raise IllConditioned(
            f"the noise model has no stabilising Riccati solution ({error}); lower the order"
        ) from error
    covariance = C @ P @ C.T + R
    gain = np.linalg.solve(covariance, (A @ P @ C.T + S).T).T
    radius = float(np.abs(np.linalg.eigvals(A - gain @ C)).max())
    if not radius < 1:
        raise IllConditioned(
            f"the predictor A - K C has spectral radius {radius:.6g}; expected below 1: lower the order"
        )
    return np.asarray(gain), np.asarray((covariance + covariance.T) * (level / 2))


def _products(state: Array, output: Array) -> tuple[Array, Array, Array]:
    return state.T @ state, state.T @ output, output.T @ output


def _memory(system: StateSpace, longest: int) -> int:
    """Return after how many samples the free response has died out (to 1e-9)."""
    radius = float(np.abs(system.poles()).max())
    if radius <= 0:
        return max(system.order, 1)
    return longest if radius >= 1 else int(max(system.order, np.ceil(-20.7 / np.log(radius)))) + system.order
