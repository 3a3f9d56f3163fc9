"""Matrix polynomials in several variables, realised as linear fractional transformations with few channels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from afdsvc.lti.statespace import Array

Polynomial = dict[tuple[int, ...], Array]  # coefficient matrices by multi-index of the variables' powers
RANK_TOLERANCE = 1e-11


@dataclass(frozen=True, slots=True, eq=False)
class MatrixLft:
    """``out = constant v + Bw w``, ``z = Cz v + Dzw w``, ``w = s z``: channel c carries variable ``variable[c]``."""

    constant: Array
    Bw: Array
    Cz: Array
    Dzw: Array
    variable: NDArray[np.int64]


def factored(polynomial: Polynomial) -> MatrixLft:
    """Return the polynomial as an LFT: variables are taken out one by one, each with as few channels as its rank."""
    count = len(next(iter(polynomial)))
    shape = next(iter(polynomial.values())).shape
    powers = [k for k in polynomial if any(k)]
    if not powers:
        constant = polynomial.get((0,) * count, np.zeros(shape))
        return MatrixLft(constant, np.zeros((shape[0], 0)), np.zeros((0, shape[1])), np.zeros((0, 0)), np.zeros(0, np.int64))
    v = max(range(count), key=lambda i: sum(k[i] > 0 for k in powers))
    divided = {_lower(k, v): m for k, m in polynomial.items() if k[v]}
    rest = factored({k: m for k, m in polynomial.items() if not k[v]} or {(0,) * count: np.zeros(shape)})
    return _combine(divided, rest, v)


def compressed(lft: MatrixLft) -> MatrixLft:
    """Return the same LFT without channels that repeat each other (dependent z's, or w's that act alike)."""
    while True:
        smaller = _merge_equal_z(_transposed(_merge_equal_z(_transposed(lft))))
        if smaller.variable.size == lft.variable.size:
            return lft
        lft = smaller


def _transposed(lft: MatrixLft) -> MatrixLft:
    return MatrixLft(lft.constant.T, lft.Cz.T, lft.Bw.T, lft.Dzw.T, lft.variable)


def _merge_equal_z(lft: MatrixLft) -> MatrixLft:
    """Express the z of every variable by as few of them as are independent; ``z = T z'`` makes ``w = T w'``."""
    blocks, variable = [], []
    keep = np.zeros(0, np.int64)
    for v in np.unique(lft.variable):
        own = np.flatnonzero(lft.variable == v)
        chosen, X = _independent_columns(np.hstack([lft.Cz[own], lft.Dzw[own]]).T)
        blocks.append((own, X.T))
        keep = np.concatenate([keep, own[chosen]])
        variable.append(np.full(chosen.size, v))
    if keep.size == lft.variable.size:
        return lft
    T = np.zeros((lft.variable.size, keep.size))
    column = 0
    for own, X in blocks:
        T[own, column : column + X.shape[1]] = X
        column += X.shape[1]
    return MatrixLft(lft.constant, lft.Bw @ T, lft.Cz[keep], lft.Dzw[keep] @ T, np.concatenate(variable))


def _lower(index: tuple[int, ...], v: int) -> tuple[int, ...]:
    return (*index[:v], index[v] - 1, *index[v + 1 :])


def _combine(divided: Polynomial, rest: MatrixLft, v: int) -> MatrixLft:
    """Return ``rest + s_v divided``, with the common factor of ``divided`` on its cheaper side."""
    keys = list(divided)
    L, left = _common_left(np.hstack([divided[k] for k in keys]))
    Rt, right = _common_left(np.hstack([divided[k].T for k in keys]))
    if L.shape[1] <= Rt.shape[1]:
        inner = factored(dict(zip(keys, np.split(left, len(keys), axis=1), strict=True)))
        return _join(rest, v, inner, Bw=L, Cz=inner.constant, w_to_inner=False)
    inner = factored({k: m.T for k, m in zip(keys, np.split(right, len(keys), axis=1), strict=True)})
    return _join(rest, v, inner, Bw=inner.constant, Cz=Rt.T, w_to_inner=True)


def _join(rest: MatrixLft, v: int, inner: MatrixLft, Bw: Array, Cz: Array, w_to_inner: bool) -> MatrixLft:
    """Stack channels: those of this variable, those of the inner factor, those of the rest.

    With ``w_to_inner`` the inner factor is driven by this variable's w and acts on the output; without, it is driven by
    the input and makes this variable's z.
    """
    r, ci, cr = Bw.shape[1], inner.variable.size, rest.variable.size
    a, b = rest.constant.shape
    Dzw = np.zeros((r + ci + cr,) * 2)
    Dzw[r : r + ci, r : r + ci] = inner.Dzw
    Dzw[r + ci :, r + ci :] = rest.Dzw
    if w_to_inner:
        Dzw[r : r + ci, :r] = inner.Cz
        B_inner, C_inner = inner.Bw, np.zeros((ci, b))
    else:
        Dzw[:r, r : r + ci] = inner.Bw
        B_inner, C_inner = np.zeros((a, ci)), inner.Cz
    variable = np.concatenate([np.full(r, v), inner.variable, rest.variable])
    return MatrixLft(rest.constant, np.hstack([Bw, B_inner, rest.Bw]), np.vstack([Cz, C_inner, rest.Cz]), Dzw, variable)


def _common_left(stacked: Array) -> tuple[Array, Array]:
    """Return L and X with ``stacked = L X``, L being as few columns of ``stacked`` as its rank.

    Taking columns instead of singular vectors keeps zeros exactly zero, whatever the units of the rows.
    """
    chosen, X = _independent_columns(stacked)
    return stacked[:, chosen], X


def _independent_columns(stacked: Array) -> tuple[NDArray[np.int64], Array]:
    """Return column numbers that span the columns, and X with ``stacked = stacked[:, chosen] X``."""
    rows = np.abs(stacked).max(axis=1, keepdims=True, initial=0.0)
    even = stacked / np.where(rows > 0, rows, 1.0)
    columns = np.abs(even).max(axis=0, initial=0.0)
    columns = np.where(columns > 0, columns, 1.0)
    even = even / columns
    _, triangle, pivots = qr(even, mode="economic", pivoting=True)
    size = np.abs(np.diag(triangle))
    r = int((size > RANK_TOLERANCE * size[0]).sum()) if size.size and size[0] > 0 else 0
    chosen = np.sort(pivots[:r]).astype(np.int64)
    X = np.linalg.lstsq(even[:, chosen], even, rcond=None)[0] if r else np.zeros((0, even.shape[1]))
    X = np.where(np.abs(X) > 1e-13, X, 0.0)
    X[:, chosen] = np.eye(r)
    return chosen, X * (columns[None, :] / columns[chosen][:, None])
