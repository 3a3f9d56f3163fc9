"""The default choice of coprime factors for a plant and a controller."""

from __future__ import annotations

from afdsvc.errors import BadInput, IllConditioned
from afdsvc.lti.coprime import Factorisation, controller_factorisation, observer_form, proportional_factorisation
from afdsvc.lti.statespace import StateSpace


def factorise(plant: StateSpace, controller: StateSpace) -> Factorisation:
    """Return coprime factors of the plant and the controller that stabilises it (positive feedback ``u = K y``).

    1. a static controller P: ``F = (I - P D)^-1 P C``, so V = I, Vt is static and beta = y - N alpha;
    2. a controller of the plant's order: its observer form when well conditioned, so J_K has the plant's order;
    3. any other: the general form, of order n + n_K, with the cheapest gains keeping half the loop's stability margin.

    Raises `NotStabilising` with the offending pole, `BadInput` when the widths do not fit.
    """
    wanted = (plant.inputs, plant.outputs)
    if (controller.outputs, controller.inputs) != wanted:
        raise BadInput(
            f"the controller has {controller.outputs} outputs and {controller.inputs} inputs; a plant with "
            f"{plant.inputs} "
            f"inputs and {plant.outputs} outputs needs {wanted[0]} and {wanted[1]}"
        )
    if not controller.order:
        return proportional_factorisation(plant, controller.D)
    if controller.order == plant.order:
        try:
            return observer_form(plant, controller)
        except IllConditioned:
            pass  # the general form has twice the order and no such condition
    return controller_factorisation(plant, controller)
