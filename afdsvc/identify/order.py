"""How many states the data support, decided on windows that were not used for the estimate.

The recordings are cut into groups. For every group the reduced-rank predictor of all the others is tried on it: each
further state lowers (or raises) the error of the outputs to come, weighted by their covariance. The order is the
smallest whose mean loss is within one standard error of the best (the one-standard-error rule of cross-validation).
Nothing is assumed about the noise; disturbance modes count, as they must (they are part of the predictor).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from afdsvc.dataset.arrays import Recording, scaled, scales
from afdsvc.errors import BadInput
from afdsvc.identify.compression import compress_groups, compress_size, join, lags, triangle
from afdsvc.identify.pbsid import decompose_predictor_factor
from afdsvc.lti.statespace import Array

_GROUPS = 10


@dataclass(frozen=True, slots=True, eq=False)
class OrderChoice:
    """The order chosen and what speaks for it: mean loss of every order (relative to order 0) and its standard
    error."""

    order: int
    loss: Array
    standard_error: Array
    sentence: str


def choose_order(recordings: Sequence[Recording], horizon: int, largest: int, closed_loop: bool = False) -> OrderChoice:
    """Return the order between 0 and ``largest`` that predicts windows it has not seen best.

    ``horizon`` counts the lags of the past, and in open loop also the samples predicted; in ``closed_loop`` only the
    next sample is predicted, from states found as in `pbsid` (further ones depend on inputs that answer to the noise).
    Raises `BadInput` when the recordings are too short for two groups.
    """
    m, p = recordings[0].u.shape[1], recordings[0].y.shape[1]
    length = horizon + (1 if closed_loop else horizon)
    groups = min(_GROUPS, compress_size(recordings, length) // (length * (m + p)))
    if groups < 2:
        raise BadInput(
            f"{compress_size(recordings, length)} windows of {length} lags are too few to choose an order by "
            "leaving some out; "
            f"give the order, or {2 * length * (m + p)} windows"
        )
    factors = compress_groups(scaled(recordings, *scales(recordings)), length, groups)
    loss_of = _closed_loop(m, p, horizon, largest) if closed_loop else _open_loop(m, p, horizon, largest)
    others = [join([f for i, f in enumerate(factors) if i != held_out]) for held_out in range(len(factors))]
    return _one_standard_error(np.stack([loss_of(rest, own) for rest, own in zip(others, factors, strict=True)]))


Loss = Callable[[Array, Array], Array]


def _open_loop(m: int, p: int, s: int, largest: int) -> Loss:
    """Return the loss in all future outputs, with the future inputs projected out, for orders 0 to ``largest``."""
    past = np.concatenate([lags(m + p, range(m), 0, s), lags(m + p, range(m, m + p), 0, s)])
    columns = np.concatenate([lags(m + p, range(m), s, 2 * s), past, lags(m + p, range(m, m + p), s, 2 * s)])
    a, b = s * m, s * m + len(past)

    def loss(rest: Array, own: Array) -> Array:
        R, mine = (triangle(factor[:, columns]) for factor in (rest, own))
        whiten = _whitener(R[b:, b:])
        oblique = linalg.lstsq(R[a:b, a:b], R[a:b, b:], cond=1e-10)[0]
        left = linalg.svd(whiten(R[a:b, b:].T), full_matrices=False)[0][:, :largest]
        measured, predicted = left.T @ whiten(mine[a:b, b:].T), left.T @ whiten((mine[a:b, a:b] @ oblique).T)
        gain = (2 * measured * predicted - predicted**2).sum(axis=1)
        return -np.cumsum(np.pad(gain, (1, largest - len(gain))))

    return loss


def _closed_loop(m: int, p: int, past: int, largest: int) -> Loss:
    """Return the loss in the next output, for orders 0 to ``largest``."""
    ones = (np.ones(m), np.ones(p))
    y = lags(m + p, range(m, m + p), past, past + 1)

    def loss(rest: Array, own: Array) -> Array:
        found = decompose_predictor_factor(rest, len(rest), past, max(2, past // 3), False, ones, 1.0)
        T = found.state_map[:largest]
        states, mine = (factor[:, : past * (m + p)] @ T.T for factor in (rest, own))
        predictor = linalg.lstsq(states, rest[:, y])[0]
        whiten = _whitener(rest[:, y] - states @ predictor)
        losses = [float((whiten(own[:, y].T) ** 2).sum())]
        for order in range(1, T.shape[0] + 1):
            C = linalg.lstsq(states[:, :order], rest[:, y])[0]
            losses.append(float((whiten((own[:, y] - mine[:, :order] @ C).T) ** 2).sum()))
        return np.pad(np.asarray(losses) - losses[0], (0, largest + 1 - len(losses)), mode="edge")

    return loss


def _whitener(errors: Array) -> Callable[[Array], Array]:
    noise = errors.T @ errors
    root = linalg.cholesky(noise + 1e-12 * np.trace(noise) / len(noise) * np.eye(len(noise)), lower=True)
    return lambda columns: np.asarray(linalg.solve_triangular(root, columns, lower=True))


def _one_standard_error(loss: Array) -> OrderChoice:
    mean = loss.mean(axis=0)
    best = int(np.argmin(mean))
    error = (loss - loss[:, [best]]).std(axis=0, ddof=1) / np.sqrt(len(loss))
    order = int(np.flatnonzero(mean - mean[best] <= error)[0])
    sentence = (
        f"order {order}: the smallest within one standard error of the best ({best}) on {len(loss)} "
        "groups of windows left out"
    )
    return OrderChoice(order, mean, error, sentence)
