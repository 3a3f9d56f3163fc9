"""Sensor rectification: a sensor with another gain for positive than for negative motion."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_output


def _rectified(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``y + c |y|``."""
    out[0] += p[0] * abs(z[0])


def unsigned(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``y`` where it is positive and ``(1 - 2 c) y`` where it is negative: at ``c = 1`` the sign is lost."""
    out[0] += p[0] * (abs(z[0]) - z[0])


class SensorRectification:
    """A share of the absolute value in every output; where the noise leaves more to be seen, up to a sensor that has no sign at all."""

    name = "sensor_rectification"
    summary = "a sensor whose gain differs between the two directions"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per output that takes both signs: on one side its law is a change of the gain."""
        for port in [o for o in machine.outputs if o.reverses]:
            words: dict[str, Any] = {
                "physics": self.name, "family": "sensor curve", "starts": [(0.0,)],
                "predicts": "even distortion in proportion to the level, in this output alone",
                "refuted_by": "even distortion that grows with the square of the level",
            }
            yield at_output(port, _rectified, parameters=[Coefficient("share", "", -1.0, 1.0, 0.02, linear=True)], **words)
            if machine.limited == "model":
                lost = Coefficient("sign lost", "", 0.0, 1.2, 0.05, linear=True)
                yield at_output(port, unsigned, parameters=[lost], notes={"variant": "unsigned", "of": ""}, **words)
