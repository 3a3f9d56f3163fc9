"""A number of the model that follows a state: a core that saturates, a loss that grows with a flow."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Size
from afdsvc.plugins.physics.attach import (
    at_parameter,
    at_state,
    balance,
    constant,
    quantity,
    state,
    stored,
)

_STORES = {"current": "inductance", "voltage": "capacitance"}


def levelling(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``(1 + c s / (1 + s)) z_0``, ``s = (z_1 / level)^2``: as a core saturates, for either sign; ``p = (c, level)``."""
    s = (z[1] / p[1]) ** 2
    out[0] += p[0] * s / (1 + s) * z[0]


def saturating(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The rate of change of a state divided by ``1 + c s / (1 + s)``, ``s = (z_0 / level)^2``, or by what that is more than where the model holds;
    ``p = (c, level, state where the model holds, nominal coefficients of z)``."""
    total, s, held = 0.0, (z[0] / p[1]) ** 2, (p[2] / p[1]) ** 2
    for k in range(len(z)):
        total += p[3 + k] * z[k]
    out[0] += total * ((1 + p[0] * held / (1 + held)) / (1 + p[0] * s / (1 + s)) - 1)


class ParameterFollowsState:
    """Every number of code that is not known exactly, by the size of every state; of matrices what every state that belongs to no axis stores, by its own: the
    inductance of a current, the capacitance of a voltage, the area of a tank at a level. Where the state has one sign, the model holds at its mean."""

    name = "parameter_follows_state"
    summary = "a number of the model that depends on the size of a state, and levels off"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per number and state, or per state that belongs to no axis."""
        for number in machine.parameters:
            for x in machine.states:
                yield at_parameter(number, levelling, [state(x)], notes={"variant": x.name, "of": x.name}, **self._words(x))
        for x in [] if machine.code else stored(machine):
            reads, constants = balance(machine, x)
            if state(x) not in reads:  # it integrates
                reads, constants = [state(x), *reads], [constant("nominal", "", 0.0), *constants]
            if len(reads) > 1:
                held = constant("state where the model holds", x.unit, 0.0 if x.reverses else x.mean)
                yield at_state(x, saturating, reads, notes={"variant": _STORES.get(quantity(x.unit), "storage")}, **self._words(x, [held, *constants]))

    def _words(self, x: Size, constants: Sequence[Coefficient] = ()) -> dict[str, Any]:
        size = x.peak or x.rms
        return {
            "physics": self.name, "family": "follows state", "description": True,
            "parameters": [
                Coefficient("change far beyond the level", "", -1.0, 5.0, 0.02, linear=True), Coefficient("level", x.unit, 0.05 * size, 5 * size, 0.05 * size), *constants,
            ],
            "starts": [(0.0, share * size, *(c.low for c in constants)) for share in (0.25, 1.0)],
            "predicts": f"a residual in proportion to the part of the model that this number governs, which depends on the size of {x.name}",
            "refuted_by": f"a residual that is the same at every {x.name}",
        }
