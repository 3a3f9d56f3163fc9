"""Names for lines that the excitation does not make: once, twice, three times the rotation, mains, or unknown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.dataset.experiment import Run

MAINS = (50.0, 60.0)  # Hz
HARMONICS = (1, 2, 3, 4)
LOOSE = 0.012  # relative distance from the mains frequency that the grid itself may have


def label(omega: float, runs: Sequence[Run]) -> str:
    """Return "1x rotation" and so on, "mains" with its harmonic, or "unknown"."""
    width = max(4 * np.pi / (len(r) * r.dt) for r in runs)
    for speed in speeds(runs):
        for k in HARMONICS:
            if abs(omega - k * speed) < width:
                return f"{k}x rotation"
    hertz = omega / (2 * np.pi)
    for mains in MAINS:
        for k in HARMONICS:
            if abs(hertz - k * mains) < max(LOOSE * k * mains, 0.5 * width / (2 * np.pi)):
                return "mains" if k == 1 else f"mains, harmonic {k}"
    return "unknown"


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
