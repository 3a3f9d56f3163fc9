"""Waves along a way: candidates for what repeats with the position and not with the time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.lti.statespace import Array

LONGEST = 16384  # samples of all recordings, their beginnings
PERIODS = 200  # in the way travelled that are looked for, at most
FINENESS = 4  # wave numbers that are tried in the width of a peak
FASTEST = 0.5 * np.pi  # phase in a sample up to which a wave is resolved
MOST = 4


def wave_numbers(ways: Sequence[Array], residuals: Sequence[Array]) -> list[float]:
    """Return the wave numbers [rad per unit of the way] of the waves that the changes of a residual follow best, the best first.

    ``ways`` are the positions ``(n,)`` and ``residuals (n, p)`` of every recording. Changes from sample to sample are compared, since a residual that
    drifts hides a wave.
    """
    most = LONGEST // len(ways)
    ways, residuals = [np.nan_to_num(q[:most], posinf=0.0, neginf=0.0) for q in ways], [np.nan_to_num(e[:most]) for e in residuals]
    way, inside = np.concatenate(ways), np.concatenate([[*np.ones(len(q) - 1, bool), False] for q in ways])[:-1]
    travelled, steps = float(np.ptp(way)), np.abs(np.diff(way)[inside])
    fastest = float(np.percentile(steps, 90)) if len(steps) else 0.0
    if not fastest > 0:
        return []
    least, changes = 2 * np.pi / travelled / FINENESS, np.diff(np.vstack(residuals), axis=0)[inside]
    changes = changes / np.maximum(np.sqrt((changes**2).sum(0)), 1e-300)
    count, step = int(min(FINENESS * PERIODS, FASTEST / fastest / least)), np.exp(1j * least * way)
    shares, wave = np.zeros(count + 1), step ** (FINENESS - 1)
    for j in range(FINENESS, count + 1):
        wave = wave * step
        moved = np.diff(wave)[inside]
        shares[j] = (np.abs(moved.conj() @ changes) ** 2).sum() / (np.abs(moved) ** 2).sum()
    tops = [j for j in range(len(shares)) if shares[j] == shares[max(0, j - FINENESS) : j + FINENESS + 1].max() > 0]
    return [float(least * j) for j in sorted(tops, key=lambda j: -shares[j])[:MOST]]
