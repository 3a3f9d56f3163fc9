"""Actuator lag: the input reaches the machine through a first-order low-pass."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.attach import at_input, at_state, input_followers


def low_pass(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``tau v' + v = u``, ``tau`` the first of p while v rises and the last while it falls: the mean of v over the step replaces u."""
    tau = p[0] if z[0] > m[0] else p[len(p) - 1]
    decay = math.exp(-dt / tau)
    rest = m[0] - z[0]
    out[0] += rest * (1 - decay) * tau / dt
    m[0] = z[0] + rest * decay


def direction_dependent(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The rate of change of a state multiplied by ``1 + p[0]`` while it rises and by ``1 + p[1]`` while it falls: a rotor without a brake.

    ``p[2:]`` are the nominal coefficients of z.
    """
    rate = 0.0
    for k in range(len(z)):
        rate += p[2 + k] * z[k]
    out[0] += (p[0] if rate > 0 else p[1]) * rate


def behind_lag(plant: StateSpace, values: Sequence[float], column: int) -> StateSpace:
    """Return the plant with a lag of the time constant ``values[0]`` before an input; its output is the last state."""
    n, m = plant.order, plant.inputs
    pole = 1 / values[0]
    A = np.block([[plant.A, plant.B[:, [column]]], [np.zeros((1, n)), np.array([[-pole]])]])
    B = np.vstack([plant.B, np.zeros((1, m))])
    B[:n, column] = 0.0
    B[n, column] = pole
    D = plant.D.copy()
    D[:, column] = 0.0
    return StateSpace(A, B, np.hstack([plant.C, plant.D[:, [column]]]), D)


class ActuatorLag:
    """An actuator slower than the model says, at every input, upwards and downwards alike or not; a lag that the model has may differ in the two directions, too."""

    name = "actuator_lag"
    summary = "a first-order low-pass between the command and what the actuator does"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return two hypotheses per input, and one per state that does nothing but follow an input."""
        span = 1 / machine.bandwidth
        words: dict[str, Any] = {"physics": self.name, "family": "timing", "substeps": 4}
        uneven_words = words | {"predicts": "a lag that differs between rising and falling", "refuted_by": "the same lag in both directions"}
        for port in machine.inputs:
            constants = [Coefficient(f"time constant{way}", "s", 1e-3 * span, 300 * span, 0.05 * span) for way in ("", " rising", " falling")]
            yield at_input(
                port, low_pass, memory=1, unsettled=1, parameters=constants[:1], starts=[(0.1 * span,), (span,), (10 * span,)],
                linear=lambda plant, values, column=port.index: behind_lag(plant, values, column),
                predicts="phase lag that saturates and gain that falls with frequency, for this input only",
                refuted_by="a gain that stays the same where the phase falls", **words,
            )
            yield at_input(
                port, low_pass, memory=1, unsettled=1, parameters=constants[1:], starts=[(a * span, b * span) for a, b in ((0.3, 1.0), (1.0, 0.3), (1.0, 10.0), (10.0, 1.0))],
                notes={"variant": "rising and falling", "of": ""}, **uneven_words,
            )
        for x, reads, constants in input_followers(machine):
            yield at_state(
                x, direction_dependent, reads, starts=[(0.0, 0.0, *(c.low for c in constants))], notes={"variant": "rising and falling", "of": ""},
                parameters=[*(Coefficient(f"change of the rate {way}", "", -0.95, 20.0, 0.02, linear=True) for way in ("rising", "falling")), *constants], **uneven_words,
            )
