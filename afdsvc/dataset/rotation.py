"""What turns with the rotor, taken out of a recording before anything is identified from it.

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
