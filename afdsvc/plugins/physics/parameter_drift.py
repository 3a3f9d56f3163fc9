"""Parameter drift: a number of the model that changes slowly during a recording, as with warm-up, wear, fouling or ageing."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Law, Machine
from afdsvc.plugins.physics import parameter_change
from afdsvc.plugins.physics.attach import at_state, balance, constant, decaying, state
from afdsvc.plugins.physics.parameter_change import ParameterChange

LONGEST = 10.0  # time constant, over the length of all recordings together, that is as good as a steady drift


def drifting_gain(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``(1 + c) z``, ``c = rate tau (1 - exp(-t / tau))``, ``t`` since the recording began; a number keeps its sign and at most doubles."""
    out[0] += min(max(p[0] * p[1] * (1 - math.exp(-m[0] / p[1])), -0.99), 1.0) * z[0]
    m[0] += dt


def drifting_terms(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """Terms of a balance ``1 + c`` times as large, as in ``drifting_gain``; ``p[2:]`` are their nominal coefficients."""
    total = 0.0
    for k in range(len(z)):
        total += p[2 + k] * z[k]
    out[0] += min(max(p[0] * p[1] * (1 - math.exp(-m[0] / p[1])), -0.99), 1.0) * total
    m[0] += dt


def drifting_inertia(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """A mass or a capacity ``1 + c`` times as large, as in ``drifting_gain``: the rate of change divided by that; ``p[2:]`` are the nominal coefficients."""
    total = 0.0
    for k in range(len(z)):
        total += p[2 + k] * z[k]
    change = min(max(p[0] * p[1] * (1 - math.exp(-m[0] / p[1])), -0.99), 1.0)
    out[0] -= total * change / (1 + change)
    m[0] += dt


_LAWS: dict[Law, Law] = {parameter_change.gain: drifting_gain, parameter_change.terms: drifting_terms, parameter_change.inertia: drifting_inertia}


class ParameterDrift:
    """Gain of every input and output; of code every parameter that is not known exactly, of matrices stiffness, damping and mass of every axis, and
    loss and capacity of every store."""

    name = "parameter_drift"
    summary = "a number of the model that changes slowly with time, steadily or levelling off"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per number and place."""
        for h in ParameterChange().over_time(machine):
            yield replace(h, law=_LAWS[h.law], linear=None, **self._course(machine, h.parameters[1:]))
        for store, loss in decaying(machine) if machine.driven and not machine.code else ():
            own = [constant("nominal", "", -loss)]
            yield at_state(store, drifting_terms, [state(store)], notes={"variant": "loss", "of": "loss"}, **self._course(machine, own))
            reads, constants = balance(machine, store)
            if len(reads) > 1:
                yield at_state(store, drifting_inertia, reads, notes={"variant": "capacity", "of": "capacity"}, **self._course(machine, constants))

    def _course(self, machine: Machine, constants: Iterable[Coefficient] = ()) -> dict[str, Any]:
        fixed, whole = tuple(constants), machine.duration
        return {
            "physics": self.name, "family": "drift", "memory": 1,
            "parameters": (
                Coefficient("rate", "1/s", -100 / whole, 100 / whole, 0.02 / whole, linear=True),
                Coefficient("time constant", "s", 0.01 * whole, LONGEST * whole, 0.1 * whole), *fixed,
            ),
            "starts": tuple((0.0, share * whole, *(c.low for c in fixed)) for share in (0.1, 0.5, LONGEST / 2)),
            "predicts": "a residual that grows with time, in proportion to the part of the model that this number governs",
            "refuted_by": "a residual that is the same at the beginning and at the end",
        }
