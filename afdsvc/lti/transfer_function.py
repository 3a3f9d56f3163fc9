"""Transfer functions as state-space systems, by canonical forms (Kailath, *Linear Systems*, 1980, section 2.1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array, StateSpace

Polynomial = Sequence[float] | Array

NEGLIGIBLE = 1e-100  # first coefficient of a denominator over the largest: its pole is beyond anything that can be computed


def from_polynomials(num: Sequence[Sequence[Polynomial]], den: Sequence[Sequence[Polynomial]], dt: float = 0.0) -> StateSpace:
    """Return the system whose transfer function from input j to output i is ``num[i][j] / den[i][j]``, highest power first.

    Each output has a block of states of its own; the first one is that output less what passes at once (``C`` picks it), so it has the
    output's unit. Without zeros, in continuous time, the others are its derivatives one after the other. Raises `BadInput` where a denominator is zero or has a lower degree than its numerator.

    >>> motor = from_polynomials([[[2.0]]], [[[0.5, 1.0]]])  # 2 / (0.5 s + 1)
    >>> motor.A.tolist(), motor.B.tolist(), motor.C.tolist()
    ([[-2.0]], [[4.0]], [[1.0]])
    """
    blocks = [_row([np.asarray(n, float) for n in ns], [np.asarray(d, float) for d in ds]) for ns, ds in zip(num, den, strict=True)]
    order, p, m = sum(len(a) for a, _, _ in blocks), len(blocks), len(blocks[0][2])
    A, B, C, D = np.zeros((order, order)), np.zeros((order, m)), np.zeros((p, order)), np.zeros((p, m))
    start = 0
    for i, (a, b, d) in enumerate(blocks):
        block = slice(start, start + len(a))
        A[block, block] = np.eye(len(a), k=1)
        if dt == 0 and not b[:-1].any():
            A[block, block][-1:] = 0.0 - a[::-1]
        else:
            A[block, block][:, :1] = 0.0 - a[:, None]
        B[block], D[i] = b, d
        C[i, start : start + 1] = 1.0
        start += len(a)
    return StateSpace(A, B, C, D, dt)


def output_states(system: StateSpace) -> list[slice]:
    """Return which states each output of a system has that `from_polynomials` made; no states for a gain."""
    firsts = [int(np.flatnonzero(row)[0]) if row.any() else system.order for row in system.C]
    return [slice(first, min((k for k in firsts if k > first), default=system.order)) for first in firsts]


def to_polynomials(system: StateSpace, output: int, of: int) -> tuple[Array, Array]:
    """Return numerator and denominator from input ``of`` to an output of a system that `from_polynomials` made, highest power first.

    The last coefficient of the denominator is 1 in continuous time; the first one is in discrete time, and where the last is 0.

    >>> [p.tolist() for p in to_polynomials(from_polynomials([[[2.0]]], [[[0.5, 1.0]]]), 0, 0)]
    [[2.0], [0.5, 1.0]]
    >>> [p.tolist() for p in to_polynomials(from_polynomials([[[0.5]]], [[[1, -0.75]]], 0.01), 0, 0)]
    [[0.5], [1.0, -0.75]]
    """
    own, through = output_states(system)[output], system.D[output, of]
    if own.start == system.order:
        return np.array([through]), np.ones(1)
    A = system.A[own, own]
    den = np.append(1.0, -A[:, 0] if A[:-1, 0].any() else -A[-1, ::-1])
    num = through * den + np.append(0.0, system.B[own, of])
    unit = den[-1] if system.dt == 0 and den[-1] else 1.0
    return _trimmed(num) / unit, den / unit


def ratio_text(num: Array, den: Array, variable: str) -> str:
    """Return a ratio of polynomials as people write it, four digits a number.

    >>> ratio_text(np.array([2.0]), np.array([0.5, 1.0]), "s")
    '2 / (0.5 s + 1)'
    """
    over, under = (" + ".join(_terms(p, variable)).replace("+ -", "- ") or "0" for p in (num, den))
    over, under = (f"({text})" if " " in text else text for text in (over, under))
    return over if under == "1" else f"{over} / {under}"


def _terms(polynomial: Array, variable: str) -> list[str]:
    powers = range(len(polynomial) - 1, -1, -1)
    words = ["" if k == 0 else f" {variable}" if k == 1 else f" {variable}^{k}" for k in powers]
    return [(w.strip() if w and c == 1 else f"{c:.4g}{w}") for c, w in zip(polynomial, words, strict=True) if c]


def from_roots(zeros: Sequence[complex], poles: Sequence[complex], gain: float, dt: float = 0.0) -> StateSpace:
    """Return the system ``gain (s - z1)(s - z2) ... / ((s - p1)(s - p2) ...)``; complex roots come in conjugate pairs.

    Raises `BadInput` for a complex root without its conjugate and for more zeros than poles.

    >>> from_roots([], [-2.0], 4.0).A.tolist()
    [[-2.0]]
    """
    return from_polynomials([[gain * _real(zeros, "zeros")]], [[_real(poles, "poles")]], dt)


def _real(roots: Sequence[complex], name: str) -> Array:
    found = np.atleast_1d(np.poly(np.atleast_1d(np.asarray(roots, dtype=complex))))
    if np.abs(found.imag).max() > 1e-9 * np.abs(found).max():
        raise BadInput(f"{name}: a complex root has no conjugate beside it; expected pairs")
    return np.asarray(found.real, dtype=np.float64)


def _row(num: list[Array], den: list[Array]) -> tuple[Array, Array, Array]:
    """Return the common denominator of one output's transfer functions but for its leading 1, the inputs' rows, and the feedthrough."""
    num, den = [_trimmed(n) for n in num], [_trimmed(d) for d in den]
    for n, d in zip(num, den, strict=True):
        if not d.size or not d.any():
            raise BadInput("a denominator is zero; expected its coefficients, highest power first")
        if abs(d[0]) < NEGLIGIBLE * np.abs(d).max():
            raise BadInput(f"a denominator begins with {d[0]:g}, negligible beside {np.abs(d).max():g}; expected its coefficients, highest power first, without leading zeros")
        if len(n) > len(d):
            raise BadInput(f"a numerator of degree {len(n) - 1} stands over a denominator of degree {len(d) - 1}; expected at most its degree")
    distinct: list[Polynomial] = list(dict.fromkeys(tuple((d / d[0]).tolist()) for d in den))
    common = _product(distinct)
    over = [n / d[0] for n, d in zip(num, den, strict=True)]
    over = [np.convolve(n, _product([o for o in distinct if o != tuple((d / d[0]).tolist())])) for n, d in zip(over, den, strict=True)]
    columns = np.column_stack([np.pad(n, (len(common) - len(n), 0)) for n in over])
    through = columns[0]
    return common[1:], columns[1:] - np.outer(common[1:], through), through


def _trimmed(polynomial: Array) -> Array:
    found = np.trim_zeros(polynomial, "f")
    return found if found.size else np.zeros(1)


def _product(factors: Sequence[Polynomial]) -> Array:
    found = np.ones(1)
    for factor in factors:
        found = np.convolve(found, factor)
    return found
