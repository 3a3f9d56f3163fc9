"""A gain that follows the level it drives: a pump against a head, a valve against a load pressure, a heater whose resistance rises."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal
from afdsvc.plugins.physics.attach import at_state, constant, decaying, state
from afdsvc.plugins.physics.gain_follows_position import geared

MOST = 100.0  # times the largest level: a supply that is as good as constant


def _orifice(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``b u (sqrt(1 - x sign(u) / s) - 1)``: an orifice between a supply, ``s`` above rest, and the level ``x``; ``p = (s, b)``.

    A valve of matched orifices (Merritt, Hydraulic Control Systems, 1967, chapter 5).
    """
    flow = p[1] * z[0]
    out[0] += flow * (math.sqrt(max(1 - math.copysign(1.0, flow) * z[1] / p[0], 0.0)) - 1)


class GainFollowsLevel:
    """An input on every state that belongs to no axis and decays by itself, such as a temperature, a level or a pressure: its effect falls or rises
    with that state, in a curve or as the flow from a supply."""

    name = "gain_follows_level"
    summary = "an actuator gain that depends on the level, pressure or temperature it drives"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return two hypotheses per such state and input that acts on it at once."""
        if machine.plant is None:
            return
        shared: dict[str, Any] = {
            "physics": self.name, "family": "follows level",
            "predicts": "a residual in proportion to input times level", "refuted_by": "a gain that is the same at every level",
        }
        for x, _ in decaying(machine):
            for u in machine.inputs:
                if gain := float(machine.plant.B[x.index, u.index]):
                    signals, driven = [Signal("u", u.index), state(x)], constant("gain", "", gain)
                    notes = {"variant": u.name, "of": u.name}
                    yield at_state(
                        x, geared, signals, notes=notes,
                        parameters=[
                            *(Coefficient(f"{part} at the rms", "", -5.0, 5.0, 0.02, linear=True) for part in ("rise", "bend")),
                            constant("middle", x.unit, x.mean), constant("rms", x.unit, x.rms), driven,
                        ],
                        starts=[(0.0, 0.0, x.mean, x.rms, gain)], **shared,
                    )
                    yield at_state(
                        x, _orifice, signals, notes=notes | {"variant": f"{u.name}, flow from a supply"},
                        parameters=[Coefficient("supply", x.unit, 0.5 * x.peak, MOST * x.peak, 0.1 * x.peak), driven],
                        starts=[(share * x.peak, gain) for share in (1.1, 2.0, 6.0)], **shared,
                    )
