"""Glitches: one or two isolated samples far from their neighbours, with nothing before or after that follows.

A sample is held against the cubic through its four neighbours. One that departs by many deviations, of the whole recording and of its
surroundings, is a glitch when a spike of one or two samples describes it far better than kinks (a velocity that jumps, as in an impact) or
a step; when such samples are rare; and when it neither follows a pulse of the excitation nor recurs with it, as what the machine does
would.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.lti.statespace import Array


def grid(column: Array) -> float:
    """Return the step of the grid the values lie on: at most half of them may differ, and all differences be multiples."""
    values = np.unique(column)
    if not 3 <= len(values) <= len(column) / 2:
        return 0.0
    gaps = np.diff(values)
    step = float(gaps.min())
    if not gaps.max() < 1e15 * step:  # finer than numbers of this size are stored
        return 0.0
    multiples = gaps / step
    return step if np.abs(multiples - np.round(multiples)).max() < 0.02 * max(1.0, float(np.median(multiples))) else 0.0


FAR = 12.0  # standard deviations from the cubic through the neighbours
COARSE = 0.3  # steps of a coarse reading that count as one deviation
AROUND = 25  # samples to either side whose deviations are the surroundings
REACH = 4  # samples to either side that a spike, kinks and a step are fitted to
PLAIN = 0.25  # mean square that a spike may leave of what the best kinks or step leave
ANSWERED = 3  # samples within which a reading may follow a pulse of the excitation
RARE = 0.005  # share of the samples beyond which they are not an accident
NORMAL = 1.4826  # standard deviation of normal noise over its median magnitude


@dataclass(frozen=True, slots=True)
class Glitch:
    """One reading that stands alone: its sample and by how much it departs from the cubic through its surroundings."""

    sample: int
    height: float


def glitches(y: Array, drive: Array, period: int = 0) -> tuple[Glitch, ...]:
    """Return the glitches of one reading ``(n,)``, NaN where missing.

    ``drive (n, m)`` is what excites the machine, repeating after ``period`` samples (0: it does not): a reading may follow a pulse of
    it at once.
    """
    if len(y) < 4 * AROUND or not np.isfinite(y).any():
        return ()
    found = _standing_out(y)
    if not found or len(found) > RARE * len(y):
        return ()
    pulses = {k + late for column in drive.T for k in _standing_out(column) for late in range(ANSWERED + 1)}
    accidents = [k for k in found if k not in pulses and not (period and _recurs(k, found, period, len(y)))]
    return tuple(Glitch(j, float(y[j] - level)) for k in accidents for j, level in _spikes(y, k))


def _standing_out(x: Array) -> list[int]:
    """Return the samples whose departure is large, and the largest among its neighbours'."""
    r = _departure(x)
    return [k for k in _far(r, COARSE * grid(x[np.isfinite(x)])) if abs(r[k]) == np.abs(r[max(k - 2, 0) : k + 3]).max()]


def _departure(y: Array) -> Array:
    """Return every sample less the cubic through its four neighbours, 0 where one of them is missing."""
    r = np.zeros(len(y))
    r[2:-2] = y[2:-2] - (4 * (y[1:-3] + y[3:-1]) - y[:-4] - y[4:]) / 6
    return np.nan_to_num(r)


def _far(r: Array, coarse: float) -> list[int]:
    """Return the samples whose departure is large beside those of the whole recording and of the surroundings."""
    size = np.abs(r)
    everywhere = max(NORMAL * float(np.median(size)), coarse, 1e-12 * float(size.max()))
    return [int(k) for k in np.flatnonzero(size > FAR * everywhere) if size[k] > FAR * _around(size, int(k))]


def _around(size: Array, k: int) -> float:
    """Return the deviation before or after, whichever is larger: a loud passage may begin or end here."""
    sides = size[max(k - AROUND, 0) : max(k - REACH, 0)], size[k + REACH + 1 : k + AROUND + 1]
    return NORMAL * max(float(np.median(side)) for side in sides if len(side))


def _spikes(y: Array, k: int) -> list[tuple[int, float]]:
    """Return the one or two samples at ``k`` that stand alone, with the level the rest has there; none where kinks or a step do as well."""
    around = y[max(k - REACH, 0) : k + REACH + 1]
    if len(around) < 2 * REACH + 1 or not np.isfinite(around).all():
        return []
    t = np.arange(-REACH, REACH + 1.0)
    kinks: list[Array] = [np.maximum(t - j, 0.0) for j in (-1, 0, 1)]
    steps: list[Array] = [np.heaviside(t, 1.0), np.heaviside(t, 0.0)]
    other = min(_left(around, t, shapes) for shapes in (kinks[:2], kinks[1:], steps[:1], steps[1:]))
    for at in ((0,), (0, 1), (-1, 0)):
        if _left(around, t, [1.0 * (t == j) for j in at]) < PLAIN * other:
            rest = ~np.isin(t, at)
            level = np.polynomial.Polynomial.fit(t[rest], around[rest], 3)
            return [(k + j, float(level(j))) for j in at]
    return []


def _left(y: Array, t: Array, shapes: Sequence[Array]) -> float:
    """Return the mean square per degree of freedom that a cubic and these shapes leave."""
    columns = np.column_stack([np.vander(t / REACH, 4), *shapes])
    e = y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
    return float(np.square(e).sum()) / (len(y) - 4 - len(shapes))


def _recurs(k: int, found: Sequence[int], period: int, samples: int) -> bool:
    """Whether there are departures whole periods away, give or take a sample, in half of the other periods or more."""
    others = {round((other - k) / period) for other in found if abs((other - k + period // 2) % period - period // 2) <= 1}
    return 2 * len(others - {0}) >= max(samples // period - 1, 1)
