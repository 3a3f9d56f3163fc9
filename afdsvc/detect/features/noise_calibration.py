"""The noise of a machine from its own quiet data: covariance of the innovations and gain of the predictor, by maximum likelihood.

For a given gain Kp the residual r follows from the data and its covariance Xi in closed form; what is left is ``n log det Xi / 2``. Three
models of growing freedom are fitted: sensor noise alone, sensor noise and noise on the inputs in one ratio, and any gain. Each further
number must earn its place (H. Akaike, *IEEE Trans. Autom. Control* 19, 1974).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.optimize import minimize_scalar

from afdsvc.api.detection import Noise
from afdsvc.detect.features.innovations import ResidualFilter
from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.whitening import innovations

SHORTEST = 500  # samples
IMPOSSIBLE = 1e30  # cost of a noise without a steady predictor
STEPS = 20  # Gauss-Newton steps of the gain
UNSETTLED = 8  # of so many samples one is left out at the beginning: the initial state is unknown


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """A gain ``(n, p)``, the covariance of its residual, ``samples log det Xi / 2`` and the numbers fitted; the two noises where they
    are known."""

    gain: Array
    covariance: Array
    cost: float
    numbers: int
    noise: Noise | None = None


def calibrate_noise(plant: StateSpace, u: Array, y: Array) -> Noise:
    """Return the noise that makes quiet data likeliest; ``u (n, m)`` and ``y (n, p)`` are samples without bursts and without faults.

    Raises `BadInput` when there are too few samples or an output does not change.
    """
    if len(y) < SHORTEST:
        raise BadInput(f"{len(y)} quiet samples are too few to calibrate the noise; expected at least {SHORTEST}")
    steps = np.diff(y, n=2, axis=0)
    sensor = np.atleast_2d(steps.T @ steps / (6.0 * len(steps)))  # white noise with these second differences: blind to slow motion
    if not (np.diag(sensor) > 0).all():
        raise BadInput(f"output {int(np.argmin(np.diag(sensor)))} does not change in {len(y)} quiet samples; expected the noise of a sensor")
    first = [fit for fit in (_sensor_noise(plant, u, y, sensor), _shaken(plant, u, y, sensor)) if fit]
    if not first:
        raise BadInput("no noise on the outputs and inputs leaves a white residual of this plant; expected a model detectable from its outputs")
    best = min(first, key=lambda fit: fit.cost + fit.numbers)
    freer = _any_gain(plant, u, y, best)
    if freer.cost + freer.numbers < best.cost + best.numbers or best.noise is None:
        K, Xi = freer.gain, freer.covariance
        return Noise(Xi, K @ Xi @ K.T, K @ Xi, len(y))
    return best.noise


def _sensor_noise(plant: StateSpace, u: Array, y: Array, sensor: Array) -> _Fit | None:
    return _stated(plant, u, y, sensor, None, 0)


def _shaken(plant: StateSpace, u: Array, y: Array, sensor: Array) -> _Fit | None:
    """Return the likeliest ratio of noise on the inputs, in proportion to what they do, to sensor noise; None without inputs."""
    drive = _drive(plant, u, sensor)
    if drive is None:
        return None

    def fitted(log_ratio: float) -> _Fit | None:
        return _stated(plant, u, y, sensor, 10**log_ratio * drive, 1)

    def cost(log_ratio: float) -> float:
        fit = fitted(log_ratio)
        return IMPOSSIBLE if fit is None else fit.cost

    best = minimize_scalar(cost, bounds=(-10.0, 10.0), method="bounded", options={"xatol": 0.02})
    return fitted(float(best.x))


def _drive(plant: StateSpace, u: Array, sensor: Array) -> Array | None:
    """Return the covariance of noise on the inputs whose effect on the outputs, over the plant's order, is that of the sensors' noise."""
    variance = np.var(u, axis=0)
    if not plant.order or not plant.inputs:
        return None
    drive = plant.B @ np.diag(np.where(variance > 0, variance, 1.0)) @ plant.B.T
    size, C, Li = 0.0, plant.C, np.linalg.inv(np.linalg.cholesky(sensor))
    for _ in range(plant.order):
        size, C = size + float(np.trace(Li @ C @ drive @ C.T @ Li.T)), C @ plant.A
    return drive / size if size > 0 else None


def _stated(plant: StateSpace, u: Array, y: Array, sensor: Array, process: Array | None, numbers: int) -> _Fit | None:
    """Return the fit of two noises, enlarged together, the sensors' part until the residual has the covariance that was seen."""
    try:
        for _ in range(3):
            found = innovations(plant, sensor, process)
            r = _residual(found.filter, u, y)
            Xi = r.T @ r / len(r)
            turn = np.linalg.cholesky(Xi) @ np.linalg.inv(np.linalg.cholesky(found.covariance))
            factor = float(np.trace(turn @ turn.T)) / len(Xi) if process is None else float(np.exp(np.linalg.slogdet(turn)[1] * 2 / len(Xi)))
            sensor, process = turn @ sensor @ turn.T, None if process is None else factor * process
        found = innovations(plant, sensor, process)
    except (AfdsvcError, np.linalg.LinAlgError):
        return None
    r = _residual(found.filter, u, y)
    Xi, cost = found.covariance, _cost(r, found.covariance)
    return _Fit(found.gain, Xi, cost, numbers, Noise(sensor, process, None, len(y)))


def _any_gain(plant: StateSpace, u: Array, y: Array, start: _Fit) -> _Fit:
    """Return the likeliest gain, by Gauss-Newton steps from another fit's."""
    K, r = start.gain, _residual(_predictor(plant, start.gain), u, y)
    Xi = r.T @ r / len(r)
    cost = _cost(r, Xi)
    for _ in range(STEPS):
        step = np.array(np.linalg.solve(*_normal_equations(plant, K, r, Xi)), dtype=np.float64)
        moved = _improved(plant, u, y, K, cost, step)
        if moved is None:
            break
        gained = cost - moved.cost
        K, Xi, cost = moved.gain, moved.covariance, moved.cost
        r = _residual(_predictor(plant, K), u, y)
        if gained < 0.01:
            break
    return _Fit(K, Xi, cost, K.size)


def _improved(plant: StateSpace, u: Array, y: Array, K: Array, cost: float, step: Array) -> _Fit | None:
    """Return the fit after a step, halved until the predictor is stable and the fit better; None when it never is."""
    for _ in range(8):
        moved = K + step.reshape(K.shape)
        if is_stable(plant.A - moved @ plant.C, plant.dt):
            r = _residual(_predictor(plant, moved), u, y)
            Xi = r.T @ r / len(r)
            if _cost(r, Xi) < cost:
                return _Fit(moved, Xi, _cost(r, Xi), K.size)
        step = step / 2
    return None


def _normal_equations(plant: StateSpace, K: Array, r: Array, Xi: Array) -> tuple[Array, Array]:
    """Return information ``(n p, n p)`` and score of the gain, what the data do not show held where it is."""
    H, g = np.zeros((K.size, K.size)), np.zeros(K.size)
    _accumulate(plant.A - K @ plant.C, plant.C, np.linalg.inv(np.linalg.cholesky(Xi)), np.ascontiguousarray(r), H, g)
    return H + 1e-9 * np.diag(np.where(np.diag(H) > 0, np.diag(H), 1.0)), g


def _predictor(plant: StateSpace, K: Array) -> StateSpace:
    direct = np.hstack([np.eye(plant.outputs), -plant.D])
    return StateSpace(plant.A - K @ plant.C, np.hstack([K, plant.B - K @ plant.D]), -plant.C, direct, plant.dt)


def _residual(filter_: StateSpace, u: Array, y: Array) -> Array:
    f = ResidualFilter(filter_)
    _, r = f.step(f.start(), y, u)
    return r[len(r) // UNSETTLED :]  # the same samples for every gain: likelihoods are compared


def _cost(r: Array, Xi: Array) -> float:
    """Return minus the log likelihood of residuals, up to a constant."""
    S = r.T @ r / len(r)
    return 0.5 * len(r) * (float(np.linalg.slogdet(Xi)[1]) + float(np.trace(np.linalg.solve(Xi, S))))


@njit(cache=True)
def _accumulate(A, C, Li, r, H, g):  # type: ignore[no-untyped-def]
    """Add the products of the normalised residual's derivatives by the gain, ``-Li C (z - A)^-1 e_i r_j`` for entry (i, j)."""
    n, p = A.shape[0], C.shape[0]
    X, D = np.zeros((p, n, n)), np.zeros((p, n * p))
    for t in range(r.shape[0]):
        e = Li @ r[t]
        for j in range(p):
            seen = Li @ (C @ X[j])
            for i in range(n):
                D[:, i * p + j] = seen[:, i]
            X[j] = A @ X[j]
            for i in range(n):
                X[j, i, i] += r[t, j]
        H += D.T @ D
        g += D.T @ e
