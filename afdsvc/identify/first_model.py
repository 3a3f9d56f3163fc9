"""A first model from a recording: one lag for each output that is a speed, one resonance for any other, by least output error.

Of an output without a unit the recording decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from afdsvc.errors import BadInput
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.statespace import Array
from afdsvc.lti.transfer_function import from_polynomials

MOST = 20_000  # samples that are fitted
DIGITS = 3
TRIED = (3.0, 30.0, 300.0)  # first guesses of the time constant, in samples
DAMPING = (0.05, 0.7)  # first guesses of the relative damping
LESS = 0.95  # of what one lag leaves: a resonance that leaves no less is a lag with a pole that the recording does not show


@dataclass(frozen=True, slots=True)
class Polynomials:
    """One output: the numerator constants of all inputs over one denominator, and the share of the output's variance that they explain."""

    num: tuple[float, ...]
    den: tuple[float, ...]
    r2: float


def first_model(u: Array, y: Array, dt: float, lag: bool | None) -> Polynomials:
    """Return the best ``num / den`` of first (``lag``) or second order from inputs ``u (n, m)`` to one output ``y (n,)``; None: of the lower
    order that follows the output as well.

    Both about their means; raises `BadInput` when an input or the output does not move.
    """
    if lag is None:
        first, second = first_model(u, y, dt, True), first_model(u, y, dt, False)
        return second if 1 - second.r2 < LESS * (1 - first.r2) else first
    u, y = u[:MOST] - u[:MOST].mean(0), y[:MOST] - y[:MOST].mean()
    if not np.ptp(y) > 0 or not np.ptp(u, axis=0).all():
        raise BadInput("an input or output does not move; expected a recording in which all of them do")

    def den(theta: Array) -> Array:
        tau = np.exp(theta[0])
        return np.array([tau, 1.0]) if lag else np.array([tau**2, 2 * np.exp(theta[1]) * tau, 1.0])

    def fitted(theta: Array) -> tuple[Array, Array]:
        plant = sample_zoh(from_polynomials([[[1.0]]], [[den(theta)]]), dt)
        a = np.poly(np.linalg.eigvals(plant.A)).real
        b = [float(sum(a[i] * h for i, h in zip(range(k + 1), _impulse(plant, len(a))[k::-1], strict=True))) for k in range(len(a))]
        X = np.column_stack([lfilter(b, a, column) for column in u.T])
        gains = np.linalg.lstsq(X, y, rcond=None)[0]
        return gains, y - X @ gains

    starts = [[np.log(tau * dt), np.log(zeta)][: 1 if lag else 2] for tau in TRIED for zeta in DAMPING[: 1 if lag else 2]]
    low, high = np.log(0.2 * dt), np.log(len(y) * dt)
    bounds = ([low, np.log(1e-3)][: len(starts[0])], [high, np.log(5.0)][: len(starts[0])])

    def rest_of(theta: Array) -> Array:
        return fitted(theta)[1]

    best = min((least_squares(rest_of, np.clip(s, *bounds), bounds=bounds, diff_step=np.full(len(s), 1e-4)) for s in starts), key=lambda f: f.cost)
    gains, rest = fitted(best.x)
    rounded = [tuple(float(f"{v:.{DIGITS}g}") for v in values) for values in (gains, den(best.x))]
    return Polynomials(rounded[0], rounded[1], 1 - float(rest @ rest) / float(y @ y))


def _impulse(plant: object, count: int) -> list[float]:
    """Return the first samples of the impulse response of a sampled plant with one input and output."""
    A, B, C, D = (getattr(plant, k) for k in "ABCD")
    found, x = [float(D[0, 0])], B
    for _ in range(count - 1):
        found.append(float((C @ x)[0, 0]))
        x = A @ x
    return found
