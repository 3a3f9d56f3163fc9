"""The sensitivity of loops, ``max |(I - G K)^-1|`` over all frequencies: the inverse is the distance to instability. And its price in a design.

H2 design alone knows no stability margin. A price on the peak alone buys one for little cost; more weight on inputs or noise buys it dearly.

Source: S. Skogestad and I. Postlethwaite, "Multivariable Feedback Control", 2nd edition, 2005, chapter 9 (peaks of S as margins).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from afdsvc.api.detection import DetectionProblem
from afdsvc.api.retuning import Diagnosed
from afdsvc.lti.frequency import transfer
from afdsvc.lti.lft import star
from afdsvc.lti.norms import largest_gain
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.retune.cost import ModelSet, model_set, with_q

FREQUENCIES = np.geomspace(1e-3, np.pi, 150)  # rad per sample; the angles of the loop's poles come on top


def sensitivity(problem: DetectionProblem, severities: Mapping[str, float], Q: StateSpace | None = None) -> float:
    """Return ``max |(I - G K(Q))^-1|`` over all frequencies, outputs in units of their noise.

    >>> from afdsvc.testing.machines import bearing_problem
    >>> sensitivity(bearing_problem("proportional"), {}) > 1
    True
    """
    model = _model(problem, severities)
    p = problem.plant.outputs
    return largest_gain(model.select(slice(p), slice(p)) if Q is None else with_q(model, Q))


def sensitivities(problem: DetectionProblem, found: Diagnosed, Q: StateSpace) -> tuple[float, float]:
    """Return the largest sensitivity at the ends and the middle of the interval, without and with Q."""
    before, after = (max(sensitivity(problem, {found.fault: s}, q) for s in _ends(found)) for q in (None, Q))
    return before, after


def _ends(found: Diagnosed) -> list[float]:
    return sorted({found.low, found.middle, found.high})


def _model(problem: DetectionProblem, severities: Mapping[str, float]) -> StateSpace:
    """Return the loop with J_K from what adds to the outputs, and alpha, to the outputs, and beta."""
    g, noise = problem.augmented.close(severities), problem.covariance if problem.output_cov is None else problem.output_cov
    p, m = g.outputs, g.inputs
    unit = np.diag(np.sqrt(np.diag(noise)))
    B = np.hstack([np.zeros((g.order, p)), g.B])
    C, D = np.vstack([np.linalg.solve(unit, g.C), g.C]), np.block([[np.eye(p), np.linalg.solve(unit, g.D)], [unit, g.D]])
    return star(StateSpace(g.A, B, C, D, g.dt), problem.interconnection, p, m)


@dataclass(frozen=True, slots=True, eq=False)
class Priced:
    """A cost over models, and ``price`` times the sum of squares of ``sensitivity / bound - 1`` where the sensitivity is beyond its bound."""

    cost: ModelSet
    loops: ModelSet
    bound: float
    price: float

    @classmethod
    def of(cls, cost: ModelSet, problem: DetectionProblem, found: Diagnosed, bound: float, price: float) -> Priced:
        """Return the cost with the price on the sensitivity at the ends and the middle of the interval."""
        models = [_model(problem, {found.fault: s}) for s in _ends(found)]
        return cls(cost, model_set(models, np.ones(len(models)), problem.plant.inputs, problem.plant.outputs, 1.0), bound, price)

    def cost_and_slope(self, Q: StateSpace) -> tuple[float, Array]:
        """Return the sum and its slope in ``[Dq Cq; Bq Aq]``; as `ModelSet` where a pole is beyond its bound."""
        value, slope = self.cost.cost_and_slope(Q)
        if self.price == 0 or not np.isfinite(value):
            return value, slope
        for A, B, C, D, into, out, Dzu, Dyw in zip(*self.loops.closed(Q), strict=True):
            points = np.exp(1j * np.unique(np.concatenate([FREQUENCIES, np.abs(np.angle(np.linalg.eigvals(A)))])))
            u, s, vh = np.linalg.svd(transfer(StateSpace(A, B, C, D, Q.dt), points))
            over = s[:, 0] > self.bound
            beyond = s[over, 0] / self.bound - 1
            left = u[over, :, :1].conj().swapaxes(1, 2) @ transfer(StateSpace(A, into, C, Dzu, Q.dt), points[over])
            right = transfer(StateSpace(A, B, out, Dyw, Q.dt), points[over]) @ vh[over, :1].conj().swapaxes(1, 2)
            value += self.price * float(np.sum(beyond**2))
            slope = slope + 2 * self.price / self.bound * np.einsum("k,kai,kja->ij", beyond, left, right).real
        return value, slope
