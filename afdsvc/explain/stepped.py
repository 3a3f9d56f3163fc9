"""Readings in steps: named from the grid they lie on. No simulation predicts them, for the noise decides which step is read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.api.physics import Size
from afdsvc.explain.explanation import Estimate, Named
from afdsvc.lti.statespace import Array

MATTERS = 0.08  # rms of the rounding error over the noise's standard deviation from which it is worth saying


def stepped(outputs: Sequence[Size], noise_sd: Array, effect: int) -> tuple[Named, ...]:
    """Return one name per output whose steps matter beside its noise (rms of rounding: step / sqrt(12))."""
    found: list[Named] = []
    for port, sd in zip(outputs, noise_sd, strict=True):
        rounding = port.step / np.sqrt(12)
        if port.step > 0 and rounding > MATTERS * sd:
            share = float(np.clip(rounding**2 / sd**2, 0.0, 1.0))
            sentence = (
                f"sensor {port.name}: all readings lie on a grid of {port.step:.4g} {port.unit}; rounding makes up "
                f"{100 * share:.0f} % of the noise's power"
            )
            step = {"step": Estimate(port.step, 0.0, port.unit)}
            found.append(Named("quantisation", f"output:{port.name}", 1.0, step, sentence, effect + len(found), 0.0, "noise"))
    return tuple(found)
