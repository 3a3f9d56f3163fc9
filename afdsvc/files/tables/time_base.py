"""From a column of times to a start and one sample time; raises naming the row where they are not uniform.

Samples at another rate: one low-pass kernel for every column, so that what relates them is not changed below its cut-off.

The kernel is a sinc under a Kaiser window: flat (to 1e-4) up to `FLAT` of the lower of all rates involved, down by 80 dB from half of it
on. It has no delay. A column sampled with a period T contributes ``sum_k x_k h(t - k T)`` with weights that sum to one, which is a
low-pass filter and an interpolation at once and needs no common multiple of the rates. Where the kernel has not all its neighbours
there is no value.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array

TIME = "t"
UNITS = {"t": 1.0, "t_s": 1.0, "t_ms": 1e-3, "t_us": 1e-6, "t_ns": 1e-9}
STEPS = ("ts", "dt", "step")
JITTER = 0.1  # share of the sample time by which a time may miss its place


class MissingSamples(BadInput):
    """Samples are missing between two rows."""


def time_base(t: Array, where: str) -> tuple[float, float]:
    """Return start and sample time [s] of a column ``(n,)``; rows are counted from 1 below the header.

    Raises `BadInput` naming the first row that holds NaN, does not increase, follows a gap of samples, or misses its
    place in a uniform grid by more than `JITTER` of the sample time.
    """
    if len(t) < 2:
        raise BadInput(f"{where} holds {len(t)} rows; expected at least 2 to tell the sample time")
    _refuse(np.isnan(t) | np.isinf(t), where, lambda i: f"holds {t[i]}; expected a time")
    steps = np.diff(t, prepend=np.nan)
    _refuse(steps <= 0, where, lambda i: f"goes from {t[i - 1]:.15g} to {t[i]:.15g}; expected times that increase")
    step = float(np.median(steps[1:]))
    _refuse(
        steps > 1.5 * step, where,
        lambda i: f"comes {steps[i]:.6g} s after the one before it, where {step:.6g} s is usual: samples are missing; "
        "expected one recording for each side of the gap", MissingSamples,
    )  # fmt: skip
    dt = shortest_step(t)
    miss = np.abs(t - t[0] - dt * np.arange(len(t)))
    _refuse(
        miss > JITTER * dt, where,
        lambda i: f"misses its place in a grid of {dt:.6g} s by {miss[i]:.3g} s; expected uniform sampling",
    )  # fmt: skip
    return float(t[0]), dt


def own_time(columns: Mapping[str, Array]) -> str:
    """Return the column that is the time: ``t`` in seconds, ``t_ms``, ``t_us``, ``t_ns``, else the only one of time stamps; "" if none."""
    stamped = [name for name, column in columns.items() if is_stamped(column)]
    return next((name for name in UNITS if name in columns), stamped[0] if len(stamped) == 1 else "")


def own_step(columns: Mapping[str, Array]) -> tuple[str, float | None]:
    """Return the number beside vectors that is the sample time [s], ``Ts``, ``dt`` or ``step``, and its name; ("", None) if none."""
    longest = max(map(len, columns.values()), default=0)
    return next(((n, float(v[0])) for n, v in columns.items() if n.lower() in STEPS and len(v) == 1 < longest and not is_stamped(v)), ("", None))


def is_stamped(column: Array) -> bool:
    """Whether a column holds time stamps instead of numbers."""
    return column.dtype.kind == "M"


def seconds(column: Array, name: str) -> tuple[Array, str]:
    """Return a column of times in seconds and a sentence on what was done; time stamps count from the first of them."""
    if is_stamped(column):
        first = np.datetime_as_string(column[0], unit="us") if len(column) else ""
        t = np.where(np.isnat(column), np.nan, (column - column[:1]).astype("int64") * 1e-9)
        return np.asarray(t, dtype=np.float64), f"column {name} holds time stamps; t = 0 is {first} (UTC where the stamps name a zone)"
    unit = UNITS.get(name, 1.0)
    return (column, "") if unit == 1.0 else (np.asarray(column * unit), f"t is {name}, converted to s")


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


def _refuse(offends, where, sentence, error=BadInput) -> None:  # type: ignore[no-untyped-def]
    rows = np.flatnonzero(offends)
    if rows.size:
        others = f" ({rows.size} rows in all)" if rows.size > 1 else ""
        raise error(f"{where}, row {rows[0] + 1} {sentence(rows[0])}{others}")


FLAT, STOP = 0.4, 0.5  # of the lower rate
ATTENUATION = 80.0  # dB
BETA = 0.1102 * (ATTENUATION - 8.7)  # of the Kaiser window, by Kaiser's own formula
HALF = (ATTENUATION - 7.95) / (2 * 2.285 * 2 * np.pi * (STOP - FLAT))  # half the kernel's length, in periods of the lower rate
_AT_ONCE = 1 << 22  # weights held in memory


def reach(period: float) -> float:
    """Return how far [s] the kernel for a slowest period [s] looks to either side."""
    return HALF * period


def resampled(values: Array, start: float, step: float, times: Array, period: float) -> Array:
    """Return columns ``(n, c)`` sampled at ``start + k step`` at other times ``(q,)``, low-passed for the slowest ``period``.

    Every time must lie `reach` inside the samples; all in seconds.
    """
    if not len(times):
        return np.zeros((0, values.shape[1]))
    width = int(np.ceil(reach(period) / step))
    around = np.arange(-width, width + 2)
    out = np.empty((len(times), values.shape[1]))
    chunk = max(1, _AT_ONCE // len(around))
    for a in range(0, len(times), chunk):
        place = (times[a : a + chunk] - start) / step
        first = np.floor(place).astype(np.int64)
        weights = _kernel((place - first)[:, None] - around[None, :], step / period)
        weights /= weights.sum(axis=1, keepdims=True)
        rows = np.clip(first[:, None] + around[None, :], 0, len(values) - 1)  # those outside have weight 0
        out[a : a + chunk] = np.einsum("qk,qkc->qc", weights, values[rows])
    return out


def _kernel(offset: Array, ratio: float) -> Array:
    """Return the kernel at offsets in samples; ``ratio`` is the samples' period over the slowest one."""
    cut = (FLAT + STOP) * ratio  # twice the cut-off, in cycles per sample
    inside = np.clip(1 - np.square(offset * ratio / HALF), 0.0, None)
    return np.asarray(np.sinc(cut * offset) * np.where(inside > 0, np.i0(BETA * np.sqrt(inside)), 0.0))
