"""Dead zone: small commands do nothing."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_input


def _dead_zone(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The input loses what lies within ``+-width``."""
    out[0] -= min(max(z[0], -p[0]), p[0])


def two_edges(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The input loses what lies between ``-p[1]`` and ``p[0]``."""
    out[0] -= min(max(z[0], -p[1]), p[0])


class DeadZone:
    """A dead zone at every input, the same to both sides or not."""

    name = "dead_zone"
    summary = "commands below a width have no effect, larger ones lose that width"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return two hypotheses per input."""
        for port in machine.inputs:
            r = port.rms
            width = Coefficient("width", port.unit, 1e-4 * r, 0.95 * port.peak, 0.02 * r)
            words: dict[str, Any] = {
                "physics": self.name, "family": "input curve",
                "predicts": "a gain that rises with the level; distortion whose share falls with the level",
                "refuted_by": "distortion that grows faster than the level",
            }
            yield at_input(port, _dead_zone, parameters=[width], starts=[(0.03 * r,), (0.15 * r,), (0.6 * r,)], **words)
            yield at_input(
                port, two_edges, parameters=[replace(width, name="upper edge"), replace(width, name="lower edge")],
                starts=[(a * r, b * r) for a, b in ((0.05, 0.05), (0.5, 0.1), (0.1, 0.5), (0.6, 0.6))],
                notes={"variant": "asymmetric", "of": ""}, **words,
            )
