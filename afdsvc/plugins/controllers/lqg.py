"""Full-order observer with LQ state feedback."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from afdsvc.api.control_plugins import DesignedController
from afdsvc.lti.coprime import observer_factorisation
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.yjbk import interconnection
from afdsvc.plugins.controllers.settings import known, square


class Lqg:
    """Settings: ``state_weight``, ``input_weight`` (LQ), ``process_weight``, ``noise_weight`` (observer).

    Numbers, diagonals or matrices. The defaults weight the output energy and treat the observer as a Kalman filter with
    equal process and measurement noise; a plant's own recommendation is used where it has one.
    """

    name = "lqg"
    summary = "full-order observer with LQ state feedback"

    def design(self, plant: StateSpace, settings: Mapping[str, Any]) -> DesignedController:
        """Return the controller; J_K has the order of the plant."""
        known(settings, self.name, "state_weight", "input_weight", "process_weight", "noise_weight")
        F, L = lqg_gains(plant, settings)
        fact = observer_factorisation(plant, F, L)
        return DesignedController(self.name, fact, interconnection(fact), "LQ state feedback with a full-order observer")


def lqg_gains(plant: StateSpace, settings: Mapping[str, Any]) -> tuple[Array, Array]:
    """Return F (m, n) and L (n, p) with A + BF and A + LC stable."""
    n, m, p = plant.order, plant.inputs, plant.outputs
    Q = square(settings.get("state_weight", plant.C.T @ plant.C), n, "lqg", "state_weight")
    R = square(settings.get("input_weight", 1.0), m, "lqg", "input_weight")
    W = square(settings.get("process_weight", plant.B @ plant.B.T + 1e-9 * np.eye(n)), n, "lqg", "process_weight")
    V = square(settings.get("noise_weight", 1.0), p, "lqg", "noise_weight")
    return lqr(plant, Q, R), kalman_predictor_gain(plant, W, V)
