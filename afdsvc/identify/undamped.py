"""Modes that look like a periodic disturbance taken for dynamics.

The orbit of an unbalanced rotor, or mains hum, is predictable without any input. An order chosen from the data then
makes room for an undamped mode, which draws the disturbance from its initial state and is no property of the plant.
"""

from __future__ import annotations

import numpy as np

from afdsvc.lti.statespace import Array, StateSpace

#: Relative damping below which a mode counts as undamped, and how near in frequency a nominal one excuses it.
LEAST_DAMPING, NEIGHBOURHOOD = 0.01, 0.2


def undamped_modes(found: StateSpace, nominal: StateSpace) -> list[float]:
    """Return the frequencies [Hz] of undamped modes of a discrete system that the nominal one does not have nearby."""
    known = _undamped(nominal, 2 * LEAST_DAMPING)
    new = [w for w in _undamped(found, LEAST_DAMPING) if not (np.abs(known - w) < NEIGHBOURHOOD * w).any()]
    return [float(w / (2 * np.pi)) for w in new]


def _undamped(system: StateSpace, least: float) -> Array:
    poles = system.poles().astype(np.complex128)
    rates = np.log(poles[(np.abs(poles) > 0) & (poles.imag > 0)]) / system.dt
    return np.asarray(np.abs(rates[np.abs(rates.real) < least * np.abs(rates)]))
