"""From a column of times to a start and one sample time; raises naming the row where they are not uniform."""

from __future__ import annotations

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array

JITTER = 0.1  # share of the sample time by which a time may miss its place


def time_base(t: Array, where: str) -> tuple[float, float]:
    """Return start and sample time [s] of a column ``(n,)``; rows are counted from 1 below the header.

    Raises `BadInput` naming the first row that holds NaN, does not increase, follows a gap of samples, or misses its
    place in a uniform grid by more than `JITTER` of the sample time.
    """
    if len(t) < 2:
        raise BadInput(f"{where} holds {len(t)} rows; expected at least 2 to tell the sample time")
    _refuse(np.isnan(t) | np.isinf(t), where, lambda i: f"holds {t[i]}; expected a time")
    steps = np.diff(t, prepend=np.nan)
    _refuse(steps <= 0, where, lambda i: f"goes from {t[i - 1]!r} to {t[i]!r}; expected times that increase")
    step = float(np.median(steps[1:]))
    _refuse(
        steps > 1.5 * step, where,
        lambda i: f"comes {steps[i]:.6g} s after the one before it, where {step:.6g} s is usual: samples are missing; "
        "expected one recording for each side of the gap",
    )  # fmt: skip
    dt = shortest_step(t)
    miss = np.abs(t - t[0] - dt * np.arange(len(t)))
    _refuse(
        miss > JITTER * dt, where,
        lambda i: f"misses its place in a grid of {dt:.6g} s by {miss[i]:.3g} s; expected uniform sampling",
    )  # fmt: skip
    return float(t[0]), dt


def shortest_step(t: Array) -> float:
    """Return the decimal number of fewest digits that fits the times as well as their mean step does.

    Times are written with limited digits, so the mean step of ``0, 0.001, 0.002, ...`` is 0.001 but for rounding.
    """
    grid = np.arange(len(t))
    mean = float((t[-1] - t[0]) / (len(t) - 1))
    error = float(np.abs(t - t[0] - mean * grid).max())
    for digits in range(1, 17):
        step = float(f"{mean:.{digits}g}")
        if np.abs(t - t[0] - step * grid).max() <= 1.5 * error + 1e-9 * mean:
            return step
    return mean


def _refuse(offends, where, sentence) -> None:  # type: ignore[no-untyped-def]
    rows = np.flatnonzero(offends)
    if rows.size:
        others = f" ({rows.size} rows in all)" if rows.size > 1 else ""
        raise BadInput(f"{where}, row {rows[0] + 1} {sentence(rows[0])}{others}")
