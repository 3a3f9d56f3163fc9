"""An inertia that follows the position of another axis: an arm that folds is easier to swing."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import permutations
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import (
    MOST_TERMS,
    at_machine,
    balance,
    constant,
    quantity,
    radians_per_second,
    state,
    velocity,
)


def _varying(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """Lagrange's equations of ``J(q) w^2 / 2`` with ``J = J0 (1 + c d + e d^2)``, ``d = (q - mean) / rms``.

    ``w' = (a - J'(q) q' w / J0) J0 / J``, ``a`` being what the model's forces give it; ``q`` is pushed by ``r J'(q) w^2 / 2 J0``.
    ``p = (c, e, r, mean, rms, q' per velocity, coefficients of a ...)``, ``z = (q, v, w, signals of a ...)``.
    """
    d, forces = (z[0] - p[3]) / p[4], 0.0
    for k in range(3, len(z)):
        forces += p[3 + k] * z[k]
    slope, inertia = (p[0] + 2.0 * p[1] * d) / p[4], max(1.0 + (p[0] + p[1] * d) * d, 0.1)
    out[0] += 0.5 * p[2] * slope * z[2] * z[2]
    out[1] += (forces - slope * p[5] * z[1] * z[2]) / inertia - forces


class InertiaFollowsPosition:
    """Centrifugal and Coriolis forces of every pair of axes, one of which turns, and which no spring of the model joins: the inertia of one
    depends on the position of the other."""

    name = "inertia_follows_position"
    summary = "an inertia that depends on the position of another axis, with the centrifugal and Coriolis forces that go with it"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per ordered pair of axes of a model that is matrices, the first with a position."""
        for a, b in permutations(machine.axes, 2):
            signals, terms = balance(machine, b.rate)
            q = a.position
            if machine.plant is None or q is None or not signals or len(signals) > MOST_TERMS - 1:
                continue
            joined = b.position is not None and tuple(sorted((q.index, b.position.index))) in machine.deflections
            if joined or not (quantity(q.unit) == "angle" or radians_per_second(b.rate.unit)):
                continue
            rate, ratio = float(machine.plant.A[q.index, a.rate.index]), (a.rate.rms / b.rate.rms) ** 2
            yield at_machine(
                "force", _varying, [state(q), velocity(a), velocity(b), *signals], [velocity(a), velocity(b)], physics=self.name, family="cross coupling",
                parameters=[
                    Coefficient("rise at the rms", "", -5.0, 5.0, 0.02, linear=True),
                    Coefficient("bend at the rms", "", -5.0, 5.0, 0.02, linear=True),
                    Coefficient("ratio of the inertias", "", 0.0, 1e3 * ratio, ratio),
                    constant("middle", q.unit, q.mean), constant("rms", q.unit, q.rms), constant("rate", "", rate), *terms,
                ],
                starts=[(0.0, 0.0, ratio * k, q.mean, q.rms, rate, *(t.low for t in terms)) for k in (0.3, 3.0)], notes={"variant": f"{b.name} by {a.name}"},
                predicts="a residual in proportion to products of two velocities, across the axes",
                refuted_by="a residual of one axis that is the same whether the other moves or not",
            )
