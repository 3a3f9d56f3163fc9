"""Model order and horizon of subspace methods, by cross-validation over windows and an F test of the response.

The recordings are cut into groups. For every group the reduced-rank predictor of all the others is tried on it: each
further state lowers (or raises) the error of the outputs to come, weighted by their covariance. The order is the
smallest whose mean loss is within one standard error of the best (the one-standard-error rule of cross-validation).
Nothing is assumed about the noise; disturbance modes count, as they must (they are part of the predictor).

Leaving windows out weighs what the past predicts of future outputs once the future inputs are known. A deviation that
answers a broad input at once and is buried in noise then goes unseen. The regression of the outputs on the inputs of
the last samples sees it: an F test says whether there is an answer at all, and the orders compete by the error of their
simulation with the Bayesian information criterion (G. Schwarz, Annals of Statistics 6, 1978).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, stats

from afdsvc.dataset.arrays import InputOutputData, scale_recordings, scales
from afdsvc.errors import BadInput
from afdsvc.identify.methods.pbsid import decompose_predictor_factor
from afdsvc.identify.numerics.compression import compress_groups, compress_size, lags, leave_out, triangle
from afdsvc.identify.settings import SETTINGS
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, ComplexArray, StateSpace


@dataclass(frozen=True, slots=True, eq=False)
class OrderChoice:
    """The order chosen and what speaks for it: mean loss of every order (relative to order 0) and its standard
    error."""

    order: int
    loss: Array
    standard_error: Array
    sentence: str


def choose_order(recordings: Sequence[InputOutputData], horizon: int, largest: int, closed_loop: bool = False) -> OrderChoice:
    """Return the order between 0 and ``largest`` that predicts windows it has not seen best.

    ``horizon`` counts the lags of the past, and in open loop also the samples predicted; in ``closed_loop`` only the
    next sample is predicted, from states found as in `pbsid` (further ones depend on inputs that answer to the noise).
    Raises `BadInput` when the recordings are too short for two groups.
    """
    m, p = recordings[0].u.shape[1], recordings[0].y.shape[1]
    length = horizon + (1 if closed_loop else horizon)
    groups = min(SETTINGS.order_groups, compress_size(recordings, length) // (length * (m + p)))
    if groups < 2:
        raise BadInput(
            f"{compress_size(recordings, length)} windows of {length} lags are too few to choose an order by "
            "leaving some out; "
            f"give the order, or {2 * length * (m + p)} windows"
        )
    factors = compress_groups(scale_recordings(recordings, *scales(recordings)), length, groups)
    loss_of = _closed_loop(m, p, horizon, largest) if closed_loop else _open_loop(m, p, horizon, largest)
    return _one_standard_error(np.stack([loss_of(rest, own) for rest, own in zip(leave_out(factors), factors, strict=True)]))


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


SHORTEST, LONGEST = 15, 60
#: Windows required per entry of a window.
_WINDOWS_PER_ENTRY = 4


def choose_horizon(recordings: Sequence[InputOutputData], slowest: float, windows: int = 2) -> int:
    """Return block rows that cover the slowest time constant (in samples), as far as the recordings allow.

    ``windows`` is 2 for past and future of equal length, 1 for a past window only. Between `SHORTEST` and `LONGEST`
    (times two for a past window only), fewer when the recordings are short.
    """
    channels = recordings[0].u.shape[1] + recordings[0].y.shape[1]
    samples = sum(map(len, recordings))
    affordable = samples // (windows * (_WINDOWS_PER_ENTRY * channels + 1))
    longest = LONGEST * (2 if windows == 1 else 1)
    return int(max(4, min(np.clip(np.ceil(slowest), SHORTEST, longest), affordable)))


def memory(poles: ComplexArray) -> float:
    """Return the slowest time constant of discrete poles, in samples."""
    radius = float(np.abs(poles).max(initial=0.0))
    return float(-1 / np.log(np.clip(radius, 1e-6, 1 - 1e-6)))


def samples_needed(inputs: int, outputs: int, order: int) -> int:
    """Return how many samples are the least for a model of some order: windows for the smallest horizon that shows
    it."""
    horizon = max(SHORTEST, -(-order // outputs) + 2)
    return 2 * horizon * (_WINDOWS_PER_ENTRY * (inputs + outputs) + 1)


def answer_p(recordings: Sequence[InputOutputData], memory: int = 40) -> float:
    """Return the p-value of "no output answers to any input of the last ``memory`` samples" (Bonferroni over
    outputs)."""
    U = np.vstack([_lagged(r.u, memory) for r in recordings])
    Y = np.vstack([r.y[memory - 1 :] - r.y.mean(axis=0) for r in recordings])
    predicted = U @ linalg.lstsq(U, Y)[0]
    k, rest = U.shape[1], len(U) - U.shape[1]
    if rest < k:
        return 1.0
    F = ((predicted**2).sum(axis=0) / k) / (((Y - predicted) ** 2).sum(axis=0) / rest)
    return float(min(1.0, Y.shape[1] * stats.f(k, rest).sf(F).min()))


def simulated_order(
    recordings: Sequence[InputOutputData], system_of: Callable[[int], StateSpace], largest: int
) -> tuple[int, float]:
    """Return the order from 0 to ``largest`` with the smallest criterion of its simulation, and its lead over order
    0."""
    criteria = [_criterion(recordings, None)]
    criteria += [_criterion(recordings, system_of(n)) for n in range(1, largest + 1)]
    best = int(np.argmin(criteria))
    return best, float(criteria[0] - criteria[best])


def _criterion(recordings: Sequence[InputOutputData], system: StateSpace | None) -> float:
    """Return ``N log det(error covariance) + d log N``; an order that cannot be simulated is out."""
    errors = np.vstack([r.y if system is None else r.y - simulate(system, r.u)[0] for r in recordings])
    if not np.isfinite(errors).all():
        return float("inf")
    d = 0 if system is None else system.order * (system.inputs + system.outputs) + system.inputs * system.outputs
    return float(len(errors) * np.linalg.slogdet(errors.T @ errors / len(errors))[1] + d * np.log(len(errors)))


def _lagged(u: Array, memory: int) -> Array:
    """Return rows ``[u_k, u_k-1, ...]`` for every k with a full memory, shape ``(n - memory + 1, memory * m)``."""
    windows = np.lib.stride_tricks.sliding_window_view(u, memory, axis=0)
    return np.asarray(windows.reshape(len(windows), -1))
