"""Self-heating: a winding or a resistor whose resistance rises with the heat of its own current."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal, Size
from afdsvc.plugins.physics.attach import MOST_TERMS, at_input, at_state, constant, decaying, quantity, state


def warming(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``- r x i``, what the added resistance takes of a voltage or of the rate of a current: ``i = p[3] z[0] + p[4] z[1] + ...``, ``tau x' + x = (i / I)^2``; ``p = (r, tau, I, ...)``."""
    i = 0.0
    for k in range(len(z)):
        i += p[3 + k] * z[k]
    m[0] += ((i / p[2]) ** 2 - m[0]) * (1 - math.exp(-dt / p[1]))
    out[0] -= p[0] * m[0] * i


class SelfHeating:
    """A resistance that rises with the mean square of its current, wherever a voltage drives one: a state, or an output that the voltage moves at once."""

    name = "self_heating"
    summary = "a resistance that rises with the heat of its own current"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per voltage and current, with time constants from the excited band to the whole recording."""
        if machine.plant is None:
            return
        B, C, D = machine.plant.B, machine.plant.C, machine.plant.D
        for u in (v for v in machine.inputs if quantity(v.unit) == "voltage"):
            for x, loss in decaying(machine):
                if B[x.index, u.index] and quantity(x.unit) == "current":
                    through = (x.index, u.index)
                    yield at_state(x, warming, [state(x)], notes={"variant": u.name, "of": u.name}, **self._words(machine, x, u, loss, [1.0], through))
            for y in (o for o in machine.outputs if D[o.index, u.index] and quantity(o.unit) == "current"):
                terms = [(Signal("x", j), v) for j, v in enumerate(C[y.index]) if v]
                terms += [(Signal("u", j), v) for j, v in enumerate(D[y.index]) if v and j != u.index]
                if len(terms) <= MOST_TERMS:
                    weights = [float(v) for v in (D[y.index, u.index], *(v for _, v in terms))]
                    yield at_input(u, warming, [s for s, _ in terms], notes={"variant": y.name}, **self._words(machine, y, u, 1 / abs(weights[0]), weights))

    def _words(
        self, machine: Machine, current: Size, voltage: Size, resistance: float, weights: Sequence[float], through: tuple[int, int] | None = None
    ) -> dict[str, Any]:
        fast, slow, size = 1 / machine.bandwidth, max(machine.duration, 10 / machine.bandwidth), math.hypot(current.mean, current.rms)
        return {
            "physics": self.name, "family": "relaxation", "memory": 1, "unsettled": 1,
            "parameters": [
                Coefficient(
                    "resistance at the rms", f"{voltage.unit}/{current.unit}", 0.0, 5 * resistance, 0.02 * resistance, linear=True, through=through, unsigned=True
                ),
                Coefficient("time constant", "s", 0.3 * fast, slow, 0.1 * fast), constant("rms", current.unit, size),
                *(constant("nominal", "", w) for w in weights),
            ],
            "starts": [(0.0, fast ** (1 - s) * slow**s, size, *weights) for s in (0.1, 0.4, 0.7)],
            "predicts": "a current that falls some time after a strong passage begins, whatever its sign, and returns after it",
            "refuted_by": "a resistance that stays the same, or changes at once",
        }
