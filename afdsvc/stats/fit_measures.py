"""How well a predicted output matches a measured one, under the names the field uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True)
class Measures:
    """Agreement of one output.

    ``r2`` is the thesis' measure ``1 - |y - yhat| / |y - mean|`` (its Eq 4.38; elsewhere called the NRMSE fit),
    ``nrmse`` the ratio itself, ``r2_classical`` the coefficient of determination ``1 - ratio**2``. All 1 (0 for nrmse)
    when perfect.
    """

    r2: float
    nrmse: float
    r2_classical: float


def measures(measured: Array, predicted: Array) -> list[Measures]:
    """Return the measures of every output of ``(N, p)`` arrays; raises `BadInput` when an output does not move at
    all."""
    if measured.shape != predicted.shape:
        raise BadInput(
            f"measured outputs have shape {measured.shape}, predicted ones {predicted.shape}; expected equal shapes"
        )
    spread = np.linalg.norm(measured - measured.mean(axis=0), axis=0)
    if not (spread > 0).all():
        raise BadInput(
            f"output {int(np.argmin(spread))} is constant over {len(measured)} samples; expected a moving output"
        )
    ratio = np.linalg.norm(measured - predicted, axis=0) / spread
    return [Measures(float(1 - r), float(r), float(1 - r * r)) for r in ratio]
