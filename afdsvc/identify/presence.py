"""Is there anything to identify, although windows left out do not call for a state?

Leaving windows out weighs what the past tells of future outputs once the future inputs are known. A deviation that
answers a broad input at once and is buried in noise then goes unseen. The regression of the outputs on the inputs of
the last samples sees it: an F test says whether there is an answer at all, and the orders compete by the error of their
simulation with the Bayesian information criterion (G. Schwarz, Annals of Statistics 6, 1978).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy import linalg, stats

from afdsvc.dataset.arrays import Recording
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace


def answer_p(recordings: Sequence[Recording], memory: int = 40) -> float:
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
    recordings: Sequence[Recording], system_of: Callable[[int], StateSpace], largest: int
) -> tuple[int, float]:
    """Return the order from 0 to ``largest`` with the smallest criterion of its simulation, and its lead over order
    0."""
    criteria = [_criterion(recordings, None)]
    criteria += [_criterion(recordings, system_of(n)) for n in range(1, largest + 1)]
    best = int(np.argmin(criteria))
    return best, float(criteria[0] - criteria[best])


def _criterion(recordings: Sequence[Recording], system: StateSpace | None) -> float:
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
