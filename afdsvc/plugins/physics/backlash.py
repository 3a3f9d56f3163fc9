"""Backlash: play that has to be crossed at every reversal."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_input, at_output, quantity


def _play(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """What follows stays where it is until pushed by either edge of the gap; ``m`` is where it is.

    Edges worn unevenly touch at two widths, ``gap (1 +- wear)``.
    """
    for k in range(2):
        half = 0.5 * p[0] * (1 + (2 * k - 1) * p[1])
        m[k] = min(max(m[k], z[0] - half), z[0] + half)
        out[0] += 0.5 * (m[k] - z[0])


class Backlash:
    """Play at every input and in the drive of every sensor, those of speeds apart: play lets a position lag, and a speed for a moment only."""

    name = "backlash"
    summary = "a gap that is crossed without effect at every reversal"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per input and per output."""
        for port, attach in [*((i, at_input) for i in machine.inputs), *((o, at_output) for o in machine.outputs if quantity(o.unit) != "velocity")]:
            r = port.rms
            yield attach(
                port, _play, physics=self.name, family="memory", memory=2,
                parameters=[
                    Coefficient("gap", port.unit, 1e-4 * r, 1.8 * port.peak, 0.03 * r), Coefficient("wear", "", 0.0, 0.5, 0.05, nuisance=True),
                ],
                starts=[(0.05 * r, 0.1), (0.3 * r, 0.1), (1.0 * r, 0.1)],
                predicts="a loop of constant width at every level, and flat spots at the reversals",
                refuted_by="a loop that widens in proportion to the level",
            )
