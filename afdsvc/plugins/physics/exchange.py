"""Exchange: two stores that the model keeps apart are joined by a leak, an open valve or a wall that conducts heat."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.attach import at_machine, constant, decaying, state


def conducted(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-c (x_1 - x_2)``, and ``r`` times that into the second store; ``p = (c, r)``."""
    flow = p[0] * (z[0] - z[1])
    out[0] -= flow
    out[1] += p[1] * flow


def turbulent(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """`conducted` as through an orifice: ``-c d sqrt(|x_1 - x_2| / d)`` in its direction; ``p = (c, r, d)``."""
    between = z[0] - z[1]
    flow = p[0] * p[2] * math.copysign(math.sqrt(abs(between) / p[2]), between)
    out[0] -= flow
    out[1] += p[1] * flow


class Exchange:
    """A flow between every two states of one unit that belong to no axis and decay by themselves, where the model has it in neither or in one direction."""

    name = "exchange"
    summary = "a flow between two stores that the model keeps apart"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return two hypotheses per pair: a flow in proportion to the difference, or to its root."""
        if machine.plant is None:
            return
        for (x, rate), (y, _) in combinations(decaying(machine), 2):
            i, j = x.index, y.index
            if x.unit != y.unit or (machine.plant.A[i, j] and machine.plant.A[j, i]):
                continue
            pair, typical = f"{x.name},{y.name}", math.hypot(x.rms, y.rms)
            words: dict[str, Any] = {
                "physics": self.name, "family": "relaxation", "predicts": "what fills one store also fills the other", "refuted_by": "a store that stands still while the other moves",
            }
            given = [Coefficient("exchange rate", "1/s", 0.0, 200 * rate, 0.05 * rate, linear=True), Coefficient("capacity ratio", "", 1e-2, 1e2, 0.1)]
            reads, notes = [state(x), state(y)], {"variant": f"between {pair}", "of": pair}
            yield at_machine(
                "force", conducted, reads, reads, parameters=given, starts=[(0.0, 1.0)], notes=notes,
                linear=lambda plant, values, i=i, j=j: _joined(plant, values, i, j), **words,
            )
            yield at_machine(
                "force", turbulent, reads, reads, parameters=[*given, constant("difference", x.unit, typical)], starts=[(0.0, 1.0, typical)],
                notes=notes | {"variant": f"turbulent, between {pair}"}, **words,
            )


def _joined(plant: StateSpace, values: Sequence[float], i: int, j: int) -> StateSpace:
    A, (c, r) = plant.A.copy(), values[:2]
    A[i, [i, j]] += -c, c
    A[j, [i, j]] += r * c, -r * c
    return StateSpace(A, plant.B, plant.C, plant.D, plant.dt)
