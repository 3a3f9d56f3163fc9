"""Dead zone: small commands do nothing."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_input


def dead_zone(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The input loses what lies within ``+-width``."""
    out[0] -= min(max(z[0], -p[0]), p[0])


class DeadZone:
    """A dead zone at every input."""

    name = "dead_zone"
    summary = "commands below a width have no effect, larger ones lose that width"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per input."""
        for port in machine.inputs:
            r = port.rms
            yield at_input(
                port, dead_zone, physics=self.name, family="input curve",
                parameters=[Coefficient("width", port.unit, 1e-4 * r, 0.95 * port.peak, 0.02 * r)],
                starts=[(0.03 * r,), (0.15 * r,), (0.6 * r,)],
                predicts="a gain that rises with the level; distortion whose share falls with the level",
                refuted_by="distortion that grows faster than the level",
            )
