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


def about_centre(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The input loses what lies within ``+-p[0]`` of ``p[1]``, and ``p[2]``: its zero may be another one than the model's."""
    out[0] -= p[2] + min(max(z[0] - p[1], -p[0]), p[0])


class DeadZone:
    """A dead zone at every input, the same to both sides or not; about another centre than zero where the input has one sign, as a valve that is closed at 5 V."""

    name = "dead_zone"
    summary = "commands below a width have no effect, larger ones lose that width"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return two hypotheses per input, three where it has one sign."""
        for port in machine.inputs:
            r = port.rms
            least = min(max(1e-4 * r, port.origin), 0.9 * port.peak)  # one that no sample lies in would be an offset
            width = Coefficient("width", port.unit, least, 0.95 * port.peak, 0.02 * r)
            words: dict[str, Any] = {
                "physics": self.name, "family": "input curve",
                "predicts": "a gain that rises with the level; distortion whose share falls with the level",
                "refuted_by": "distortion that grows faster than the level",
            }
            yield at_input(port, _dead_zone, parameters=[width], starts=[(max(a * r, least),) for a in (0.03, 0.15, 0.6)], **words)
            yield at_input(
                port, two_edges, parameters=[replace(width, name="upper edge"), replace(width, name="lower edge")],
                starts=[(max(a * r, least), max(b * r, least)) for a, b in ((0.05, 0.05), (0.5, 0.1), (0.1, 0.5), (0.6, 0.6))],
                notes={"variant": "asymmetric", "of": ""}, **words,
            )
            if not port.reverses:
                centre = Coefficient("centre", port.unit, port.mean - 3 * r, port.mean + 3 * r, 0.1 * r)
                shift = Coefficient("shift", port.unit, -2 * port.peak, 2 * port.peak, 0.1 * r, nuisance=True)
                yield at_input(
                    port, about_centre, parameters=[replace(width, low=1e-4 * r), centre, shift],
                    starts=[(a * r, port.mean + c * r, zero) for zero in (0.0, port.mean) for a, c in ((0.2, 0.0), (0.6, 0.0), (0.4, -0.7), (0.4, 0.7))],
                    notes={"variant": "about another centre", "of": ""}, **words,
                )
