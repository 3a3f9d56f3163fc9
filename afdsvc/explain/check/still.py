"""Readings that never move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.api.model import Model
from afdsvc.dataset.experiment import Run
from afdsvc.errors import BadInput


def refuse_still(model: Model, held: Sequence[Run]) -> None:
    """Raise `BadInput` where a reading never moves in what is held out: no fit could be shown there."""
    for j, v in enumerate(model.outputs):
        y = np.concatenate([r.Y[:, j] for r in held])
        if np.nanmax(y) == np.nanmin(y):
            names = ", ".join(r.name for r in held)
            reading = f"y_{v.name} reads {np.nanmin(y) + 0.0:.6g} {v.unit} in every sample"
            raise BadInput(f"{names}, held out: {reading}; expected recordings in which it moves")
