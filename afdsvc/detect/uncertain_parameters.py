"""Stated uncertainty of a model's parameters, checked, and the plant with uncertain entries of its matrices pulled out."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from afdsvc.api.detection import DetectionProblem
from afdsvc.errors import BadInput
from afdsvc.lti.lft import AugmentedPlant, FaultDirection, augment
from afdsvc.lti.sampled_lft import sample_augmented
from afdsvc.lti.statespace import Array, StateSpace


def uncertain_parameters(problem: DetectionProblem) -> dict[str, float]:
    """Return standard deviations by parameter; raises `BadInput` for one the uncertain plant does not know."""
    known = () if problem.uncertain is None else problem.uncertain.fault_names
    for name, sd in problem.uncertainty.items():
        if name not in known:
            raise BadInput(f"uncertain parameter '{name}' is not one of {', '.join(known) or 'none'}")
        if not (math.isfinite(sd) and sd >= 0):
            raise BadInput(f"uncertain parameter '{name}': relative standard deviation {sd}; expected 0 or more")
    return {name: sd for name, sd in problem.uncertainty.items() if sd > 0}


def uncertain_entries(plant: StateSpace, entry_sd: Mapping[str, Array], dt: float) -> AugmentedPlant:
    """Return a plant whose "faults" are the uncertain entries of its matrices, in their standard deviations.

    Parameters
    ----------
    plant : StateSpace
        Continuous, or discrete with sample time ``dt``.
    entry_sd : dict of str to array
        Absolute standard deviations of the entries of A, B, C, D, shapes as theirs; entries of 0 are certain.
    dt : float
        Sample time [s] of the result.

    Returns
    -------
    AugmentedPlant
        Discrete; the fault ``A[i,j]`` (rows and columns counted from 1) of severity 1 moves that entry by one standard deviation.

    Examples
    --------
    >>> import numpy as np
    >>> plant = StateSpace([[-2.0]], [[3.0]], [[1.0]], [[0.0]])
    >>> found = uncertain_entries(plant, {"A": np.array([[0.2]])}, 0.01)
    >>> round(float(np.log(found.close({"A[1,1]": 1.0}).A[0, 0]) / 0.01), 9)
    -1.8
    """
    directions = [
        _entry(plant, name, i, j, sd)
        for name in "ABCD"
        for (i, j), sd in np.ndenumerate(entry_sd.get(name, np.zeros((0, 0))))
        if sd > 0
    ]
    found = augment(plant, directions)
    return found if plant.discrete else sample_augmented(found, dt)


def _entry(plant: StateSpace, name: str, i: int, j: int, sd: float) -> FaultDirection:
    Bw, Dyw = np.zeros((plant.order, 1)), np.zeros((plant.outputs, 1))
    Cz, Dzu = np.zeros((1, plant.order)), np.zeros((1, plant.inputs))
    (Bw if name in "AB" else Dyw)[i, 0] = sd
    (Cz if name in "AC" else Dzu)[0, j] = 1.0
    return FaultDirection(f"{name}[{i + 1},{j + 1}]", Bw, Dyw, Cz, Dzu, np.zeros((1, 1)))
