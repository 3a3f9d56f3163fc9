"""Predictor-based subspace identification (PBSIDopt): consistent in closed loop, no external signal needed.

A long autoregression with inputs ``y(k) = Xi [w(k-p) ... w(k-1)] + D u(k) + e(k)``, ``w = [u, y]``, gives the
predictor's Markov parameters; shifted copies of Xi make the product of extended observability and controllability; its
singular value decomposition gives the state, and two regressions the matrices (Chiuso, Automatica 43, 2007; Houtzager,
van Wingerden and Verhaegen 2012). It uses no projection along future inputs, so feedback does not bias it; when u
reacts to y without delay, ``feedthrough`` must be off.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import linalg

from afdsvc.dataset.arrays import InputOutputData, scale_recordings, scales
from afdsvc.errors import BadInput
from afdsvc.identify.numerics.compression import Route, compress, compress_groups, compress_size, join, lags, leave_out
from afdsvc.identify.numerics.innovations_form import InnovationsForm, with_stable_predictor
from afdsvc.lti.statespace import Array, StateSpace


@dataclass(frozen=True, slots=True, eq=False)
class Predictor:
    """What the data say before an order is chosen: singular values, state map (in scaled units), compressed data."""

    past: int
    singular_values: Array
    state_map: Array
    factor: Array
    u_scale: Array
    y_scale: Array
    windows: int
    dt: float
    feedthrough: bool


def decompose_predictor(
    recordings: Sequence[InputOutputData],
    past: int,
    future: int | None = None,
    feedthrough: bool = False,
    route: Route = "auto",
) -> Predictor:
    """Return the decomposition for a past window of ``past`` lags and ``future`` block rows (default: a third of it).

    Raises `BadInput` when the past is shorter than 2 or the recordings are too short for it.
    """
    future = max(2, past // 3) if future is None else future
    if not 2 <= future <= past:
        raise BadInput(f"past window {past} and future window {future}; expected 2 <= future <= past")
    u_scale, y_scale = scales(recordings)
    relative = scale_recordings(recordings, u_scale, y_scale)
    factor = compress(relative, past + 1, route)
    windows = sum(max(0, len(r) - past) for r in relative)
    return decompose_predictor_factor(factor, windows, past, future, feedthrough, (u_scale, y_scale), recordings[0].dt)


def decompose_predictor_groups(
    recordings: Sequence[InputOutputData], past: int, groups: int, feedthrough: bool = False
) -> tuple[Predictor, list[Callable[[], Predictor]]]:
    """Return the decomposition, and for each of ``groups`` groups of consecutive windows the way to that of all the others; one pass over the data."""
    scale, windows = scales(recordings), compress_size(recordings, past + 1)
    factors = compress_groups(scale_recordings(recordings, *scale), past + 1, groups)
    known = (past, max(2, past // 3), feedthrough, scale, recordings[0].dt)
    whole = decompose_predictor_factor(join(factors), windows, *known)
    return whole, [partial(decompose_predictor_factor, rest, windows - windows // groups, *known) for rest in leave_out(factors)]


def decompose_predictor_factor(
    factor: Array, windows: int, past: int, future: int, feedthrough: bool, scale: tuple[Array, Array], dt: float
) -> Predictor:
    """Return the decomposition from compressed data (windows of ``past + 1`` lags)."""
    m, p = len(scale[0]), len(scale[1])
    width = m + p
    Z = factor[:, : past * width]
    present = factor[:, lags(width, range(m), past, past + 1)] if feedthrough else np.zeros((len(factor), 0))
    y = factor[:, lags(width, range(m, width), past, past + 1)]
    Xi = linalg.lstsq(np.hstack([Z, present]), y, cond=1e-12)[0][: past * width].T
    product = np.zeros((future * p, past * width))
    for row in range(future):  # row i predicts i samples ahead; what lies further back than the window counts as zero
        product[row * p : (row + 1) * p, row * width :] = Xi[:, : (past - row) * width]
    left, values, _ = linalg.svd(product @ Z.T, full_matrices=False)
    positive = np.where(values > 0, values, 1.0)
    # States of unit covariance, so that the regressions below are well conditioned.
    state_map = (left / positive).T @ product * np.sqrt(windows)
    return Predictor(past, values, np.asarray(state_map), factor, *scale, windows, dt, feedthrough)


def realise_predictor(predictor: Predictor, order: int) -> InnovationsForm:
    """Return the model of one order in the signals' own units, its predictor stable; raises `BadInput` when the windows cannot
    show the order."""
    if not 1 <= order <= len(predictor.singular_values):
        raise BadInput(f"order {order}; the future window shows orders 1 to {len(predictor.singular_values)}")
    m, p = len(predictor.u_scale), len(predictor.y_scale)
    width, past, T = m + p, predictor.past, predictor.state_map[:order]
    now = predictor.factor[:, : past * width] @ T.T
    then = predictor.factor[:, width:] @ T.T
    u, y = (predictor.factor[:, lags(width, side, past, past + 1)] for side in (range(m), range(m, width)))
    known = np.hstack([now, u]) if predictor.feedthrough else now
    CD = linalg.lstsq(known, y)[0].T
    e = y - known @ CD.T
    ABK = linalg.lstsq(np.hstack([now, u, e]), then)[0].T
    D = CD[:, order:] if predictor.feedthrough else np.zeros((p, m))
    A, B, K = np.split(ABK, [order, order + m], axis=1)
    system = StateSpace(
        A,
        B / predictor.u_scale,
        predictor.y_scale[:, None] * CD[:, :order],
        predictor.y_scale[:, None] * D / predictor.u_scale,
        predictor.dt,
    )
    covariance = e.T @ e / predictor.windows * np.outer(predictor.y_scale, predictor.y_scale)
    return with_stable_predictor(InnovationsForm(system, np.asarray(K / predictor.y_scale), np.asarray(covariance)))
