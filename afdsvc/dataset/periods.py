"""Settled periods of a residual, what differs between them, and the running median over neighbouring lines.

What turns with the rotor, taken out of a recording before anything is identified from it.

Unbalance drives u and y at the rotor's own frequency and is no answer to the excitation. Taking the same waves out of u, y,
alpha, beta and the reference leaves the linear relations between them as they are, but for their transients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from afdsvc.api.signals import Trace
from afdsvc.dataset.experiment import Run
from afdsvc.lti.statespace import Array

FEW = 0.01  # largest share of missing samples for which periods are estimated from the others


def fold(run: Run, e: Array) -> Array | None:
    """Return the settled periods of a residual, shape ``(periods, period, p)``; None when there are fewer than two.

    A few missing samples are the mean of the others of their phase; with more than `FEW` of them, the answer is None.
    """
    if not run.period:
        return None
    start = max(run.settled, run.period // 4)
    count = (len(e) - start) // run.period
    if count < 2:
        start, count = len(e) - 2 * run.period, 2
        if start < run.settled:
            return None
    folded = e[len(e) - count * run.period :].reshape(count, run.period, -1)
    return _bridged(folded)


def _bridged(folded: Array) -> Array | None:
    missing = np.isnan(folded)
    if np.isinf(folded).any() or missing.mean() > FEW or missing.all(0).any():
        return None
    return np.where(missing, np.nanmean(folded, axis=0), folded) if missing.any() else folded


def aperiodic_part(runs: Sequence[Run], residuals: Sequence[Array]) -> list[Array]:
    """Return the part of each period that does not repeat, ``(period, p)`` each, scaled to the variance of the noise.

    Empty when no run holds two settled periods without gaps.
    """
    folded = [f for run, e in zip(runs, residuals, strict=True) if (f := fold(run, e)) is not None]
    return [x for f in folded for x in (f - f.mean(0)) * np.sqrt(len(f) / (len(f) - 1))]


def running_median(size: Array, width: int) -> Array:
    """Return the median of the neighbourhood of each row, per column."""
    half = min(width, max(len(size) // 2 * 2 - 1, 1)) // 2
    padded = np.pad(size, ((half, half), (0, 0)), mode="reflect")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0), axis=-1)


ANGLE = "aux_angle"
ORDERS = (1, 2)  # multiples of the angle: unbalance, and what oval journals add
ROLES = ("u_", "y_", "alpha_", "beta_", "ref_")


def without_rotation(trace: Trace, orders: tuple[int, ...] = ORDERS) -> Trace:
    """Return the trace less the waves at multiples of its rotor angle [rad], by least squares; as it is without an angle."""
    if not trace.has(ANGLE) or not np.ptp(trace.column(ANGLE)) > 0:
        return trace
    angle = trace.column(ANGLE)
    waves = np.column_stack([f(k * angle) for k in orders for f in (np.cos, np.sin)])
    turned = [i for i, c in enumerate(trace.channels) if c.name.startswith(ROLES)]
    values = trace.values.copy()
    values[:, turned] = _without(waves, values[:, turned])
    return replace(trace, values=values)


def _without(waves: Array, signals: Array) -> Array:
    # the mean stays: it is the operating point, and no wave is to be fitted to it
    level = signals.mean(axis=0)
    return np.asarray(signals - waves @ np.linalg.lstsq(waves, signals - level, rcond=None)[0])


def speeds(runs: Sequence[Run]) -> list[float]:
    """Return the mean rotor speed [rad/s] of every run that recorded it (or the rotor's angle)."""
    found = []
    for r in runs:
        if "speed" in r.aux:
            found.append(float(np.abs(r.AUX[:, r.aux.index("speed")].mean())))
        elif "angle" in r.aux:
            turned = np.unwrap(r.AUX[:, r.aux.index("angle")])
            found.append(float(abs(turned[-1] - turned[0]) / (max(len(r) - 1, 1) * r.dt)))
    return [s for s in found if s > 0]
