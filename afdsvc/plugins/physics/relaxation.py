"""Relaxation: a force of the model that changes for some time after what causes it: viscoelastic springs, wakes, added mass with a memory."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_force, force, state
from afdsvc.plugins.physics.slow_mode import relaxing, with_store


class Relaxation:
    """A first-order memory of every state but its velocity in the force on every axis: a further part that dies away, or one that comes late.

    A memory of the velocity is a mass that a damper holds, which `flexible_mode` has.
    """

    name = "relaxation"
    summary = "a force that goes on changing after what causes it: a part of it relaxes"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis and state that its force depends on, from as fast as the excitation to as slow as the recordings."""
        if machine.plant is None:
            return
        fast, slow = 0.3 / machine.bandwidth, max(machine.duration, 30 / machine.bandwidth)
        for axis in machine.axes:
            for x in (machine.states[j] for j in np.flatnonzero(machine.plant.A[axis.rate.index]) if j != axis.rate.index):
                size = abs(float(machine.plant.A[axis.rate.index, x.index]))
                yield at_force(
                    axis, relaxing, [state(x)], physics=self.name, family="relaxation", memory=2, unsettled=1, notes={"variant": x.name},
                    parameters=[
                        force(axis, "relaxing part", -5 * size, 5 * size, 0.05 * size, x.unit, linear=True), Coefficient("time constant", "s", fast, slow, 0.1 * fast),
                    ],
                    starts=[(0.0, fast ** (1 - s) * slow**s) for s in (0.2, 0.4, 0.6, 0.8)],
                    linear=lambda plant, values, i=axis.rate.index, j=x.index: with_store(plant, values, i, j),
                    predicts=f"a force that answers a step of {x.name} at once and then changes to its end value", refuted_by="a force that depends on the present motion only",
                )
