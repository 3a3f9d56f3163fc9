"""Compression of recordings into one triangular factor, which holds all that subspace methods need.

The rows of the data matrix are windows ``w(k) ... w(k+L-1)`` of the stacked signals ``w = [u, y]``; its triangular
factor R (``R^T R`` = sum of all window products) has the size of a window, whatever the number of samples. Two routes:

- ``"qr"``: Householder QR block by block; memory of one block, backward stable.
- ``"gram"``: ``R^T R`` is built from correlations, using that windows overlap (each block along a diagonal follows from
  the one before by two rank-c updates), then factorised by Cholesky. About twenty times faster; its relative error
  grows with the square of the data's condition number, so it is used only where that stays below `IdentificationSettings.gram_condition`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import accumulate, pairwise
from typing import Literal, cast

import numpy as np
from scipy import linalg

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput
from afdsvc.identify.settings import SETTINGS
from afdsvc.lti.statespace import Array

Route = Literal["auto", "qr", "gram"]



def compress(recordings: Sequence[InputOutputData], length: int, route: Route = "auto") -> Array:
    """Return an upper-triangular R with ``R^T R = sum_k window(k) window(k)^T``, shape ``(L (m+p), L (m+p))``.

    A window holds ``[u(k), y(k), u(k+1), y(k+1), ...]``, ``L = length`` lags. Raises `BadInput` when the recordings
    hold fewer windows than a window has entries.
    """
    if route not in ("auto", "qr", "gram"):
        raise BadInput(f"compression route '{route}'; expected auto, qr or gram")
    compress_size(recordings, length)
    return _factor([np.hstack([r.u, r.y]) for r in recordings], length, route)


def _factor(stacks: Sequence[Array], length: int, route: Route) -> Array:
    if route != "qr":
        fast = _cholesky(np.sum([window_products(w, length) for w in stacks if len(w) >= length], axis=0))
        if route == "gram" and fast is None:
            raise BadInput("the data matrix is singular, so route 'gram' cannot factorise it; use route 'qr'")
        if fast is not None and (route == "gram" or _well_conditioned(fast)):
            return fast
    return _block_qr(stacks, length)


def compress_groups(recordings: Sequence[InputOutputData], length: int, groups: int, route: Route = "auto") -> list[Array]:
    """Return the factors of ``groups`` equal groups of consecutive windows; together they hold all the data. Raises `BadInput` as `compress` does."""
    total = compress_size(recordings, length)
    return [_factor(_windows(recordings, length, a, b), length, route) for a, b in pairwise(total * g // groups for g in range(groups + 1))]


def _windows(recordings: Sequence[InputOutputData], length: int, start: int, stop: int) -> list[Array]:
    """Return the stretches that hold windows ``start`` to ``stop`` of all the recordings' windows."""
    stretches, before = [], 0
    for r in recordings:
        windows = max(0, len(r) - length + 1)
        a, b = max(start - before, 0), min(stop - before, windows)
        if b > a:
            stretches.append(np.hstack([r.u, r.y])[a : b + length - 1])
        before += windows
    return stretches


def compress_size(recordings: Sequence[InputOutputData], length: int) -> int:
    """Return the number of windows; raises `BadInput` when there are fewer than a window has entries."""
    width = length * (recordings[0].u.shape[1] + recordings[0].y.shape[1])
    windows = sum(max(0, len(r) - length + 1) for r in recordings)
    if windows < width:
        raise BadInput(
            f"{sum(map(len, recordings))} samples are too short for windows of {length} lags: "
            f"{windows} windows for {width} unknown directions; record at least {width + length} samples"
        )
    return windows


def join(factors: Sequence[Array]) -> Array:
    """Return the factor of all the data whose factors are given (R-only update)."""
    return triangle(np.vstack(list(factors)))


def leave_out(factors: Sequence[Array]) -> list[Array]:
    """Return for each of at least two factors that of the data of all the others."""
    before, after = (list(accumulate(several, lambda a, b: join([a, b]))) for several in (factors, factors[::-1]))
    middle = [join(pair) for pair in zip(before, after[-3::-1], strict=False)]
    return [after[-2], *middle, before[-2]]


def factor_of(blocks: Callable[[], Iterator[Array]]) -> Array:
    """Return the triangular factor of a tall matrix handed out in blocks of rows; ``blocks`` may be asked for twice.

    Same two routes as `compress`: the cross product when it is well enough conditioned, Householder QR otherwise.
    """
    fast = _cholesky(np.asarray(sum(block.T @ block for block in blocks())))
    if fast is not None and _well_conditioned(fast):
        return fast
    factor: Array = np.zeros((0, 0))
    for block in blocks():
        factor = triangle(np.vstack([factor, block]) if factor.size else block)
    return factor


def triangle(rows: Array) -> Array:
    """Return the triangular factor R of a QR factorisation."""
    return cast(Array, np.linalg.qr(rows, mode="r"))


def lags(width: int, channels: Sequence[int], start: int, stop: int) -> Array:
    """Return the columns of a window that hold ``channels`` (of ``width``) at lags ``start`` to ``stop``
    (exclusive)."""
    return np.asarray([lag * width + c for lag in range(start, stop) for c in channels], dtype=np.intp)


def window_products(w: Array, length: int) -> Array:
    """Return ``sum_k window(k) window(k)'`` for the windows of ``length`` lags of signals ``w (N, c)``, from
    correlations."""
    count, width = len(w) - length + 1, w.shape[1]
    gram = np.empty((length, width, length, width))
    for j in range(length):
        gram[0, :, j] = w[:count].T @ w[j : j + count]
    for i in range(length - 1):
        enter = np.multiply.outer(w[count + i], w[count + i : count + length - 1])
        leave = np.multiply.outer(w[i], w[i : length - 1])
        gram[i + 1, :, i + 1 :] = gram[i, :, i : length - 1] + enter - leave
    flat = gram.reshape(length * width, length * width)
    upper = np.triu(flat)
    return upper + np.triu(flat, 1).T


def _cholesky(gram: Array) -> Array | None:
    try:
        return np.asarray(linalg.cholesky(gram, lower=False))
    except linalg.LinAlgError:
        return None


def _well_conditioned(factor: Array) -> bool:
    # Only the condition left after scaling the columns counts: Cholesky does not mind the scale of a column.
    rcond, _ = linalg.lapack.dtrcon(factor / np.linalg.norm(factor, axis=0), norm="1", uplo="U")
    return float(rcond) * SETTINGS.gram_condition > 1


def _block_qr(stacks: Sequence[Array], length: int) -> Array:
    width = length * stacks[0].shape[1]
    rows = 6 * width
    factor = np.zeros((width, width))
    buffer = np.empty((width + rows, width), order="F")
    for w in stacks:
        if len(w) < length:
            continue
        view = np.lib.stride_tricks.sliding_window_view(w, length, axis=0).swapaxes(1, 2)
        for start in range(0, len(view), rows):
            block = view[start : start + rows]
            used = buffer[: width + len(block)]
            used[:width] = factor
            used[width:] = block.reshape(len(block), width)
            reduced, _, _, _ = linalg.lapack.dgeqrf(used, lwork=64 * width)
            factor = np.triu(reduced[:width])
    return np.asarray(factor)
