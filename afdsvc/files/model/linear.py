"""A model whose dynamics are Python code, as the linear model that methods for linear models take instead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from afdsvc.api.model import Model
from afdsvc.errors import BadInput
from afdsvc.identify.parameters.structure import model_structure
from afdsvc.lti.statespace import Array, StateSpace

STEP = 1e-3  # of a standard deviation, for the slopes of the entries


def linear_model(model: Model) -> Model:
    """Return the model with matrices and without code: the linear part its code offers, else its linearisation around rest.

    Where the simulator states how well its parameters are known, so are the entries they make. Raises `BadInput` when
    the simulator does not give rates and outputs of the right number.
    """
    if model.dynamics is None:
        return model
    if model.plant is not None:
        return replace(model, dynamics=None, states=model.states[: model.plant.order], parameters={}, extra={}, raw="")
    plant, sds = _around_rest(model)
    return replace(model, plant=plant, dynamics=None, entry_sd=sds, extra={}, raw="")


def _around_rest(model: Model) -> tuple[StateSpace, dict[str, Array]]:
    try:
        structure = model_structure(model)
        values = np.array([p.value for p in structure.parameters])
        plant = structure.build(values)
    except (ValueError, IndexError, TypeError, KeyError, ZeroDivisionError) as error:
        raise BadInput(f"{model.origin or model.name}: the simulator fails at rest: {type(error).__name__}: {error}") from error
    n, m, p = len(model.states), len(model.inputs), len(model.outputs)
    for name, shape in (("A", (n, n)), ("B", (n, m)), ("C", (p, n)), ("D", (p, m))):
        found = getattr(plant, name).shape
        if found != shape or not np.isfinite(getattr(plant, name)).all():
            raise BadInput(f"{model.origin or model.name}: linearised, the simulator's {name} has shape {found}; expected finite {shape}")
    sds = {name: np.zeros(getattr(plant, name).shape) for name in "ABCD"}
    for i, parameter in enumerate(structure.parameters):
        moved = values.copy()
        moved[i] += STEP * parameter.sd
        there = structure.build(moved)
        for name in "ABCD":
            sds[name] = np.hypot(sds[name], (getattr(there, name) - getattr(plant, name)) / STEP)
    sizes = {name: np.abs(getattr(plant, name)) for name in "ABCD"}
    return plant, {name: np.where(sd > 1e-6 * sizes[name], sd, 0.0) for name, sd in sds.items()}  # rounding is no uncertainty
