"""Bounds that loops with Q keep, and their price in a design: standard deviations within limits, and sensitivity.

The sensitivity is ``max |(I - G K)^-1|`` over all frequencies: its inverse is the distance to instability.

H2 design alone knows no stability margin. A price on the peak alone buys one for little cost; more weight on inputs or noise buys it dearly.

Source: S. Skogestad and I. Postlethwaite, "Multivariable Feedback Control", 2nd edition, 2005, chapter 9 (peaks of S as margins).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from afdsvc.api.detection import DetectionProblem
from afdsvc.api.retuning import DiagnosedFault, LoopCost
from afdsvc.errors import BadInput
from afdsvc.lti.frequency import transfer
from afdsvc.lti.lft import star
from afdsvc.lti.norms import largest_gain, output_covariance
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.retune.cost import ModelSet, model_set, signal_model, with_q
from afdsvc.retune.settings import RetuneSettings

AT_BOUND = 0.95  # share of a bound from which it is called binding: the design stops short of it
FILLED = 0.95  # share of a limit that noise peaks may fill with Q: the rest is for the switch
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


def possible_faults(problem: DetectionProblem, found: DiagnosedFault) -> list[dict[str, float]]:
    """Return what the machine may be: damaged as diagnosed (ends and middle of the interval), healthy, or damaged as much by another fault.

    Machines that the running controller does not hold are left out, but for those that were diagnosed.
    """
    diagnosed = [{found.fault: s} for s in sorted({found.low, found.middle, found.high})]
    others = [{name: found.middle} for name in problem.fault_names if name != found.fault]
    return [*diagnosed, {}, *(o for o in others if is_stable(_model(problem, o).A, problem.plant.dt))]


def sensitivities(problem: DetectionProblem, found: DiagnosedFault, Q: StateSpace) -> Array:
    """Return the sensitivities of all `possible_faults` without and with Q ``(k, 2)``, inf for an unstable loop."""

    def peak(case: dict[str, float], q: StateSpace | None) -> float:
        try:
            return sensitivity(problem, case, q)
        except BadInput:
            return float("inf")

    return np.array([[peak(case, q) for q in (None, Q)] for case in possible_faults(problem, found)])


def accepted(problem: DetectionProblem, found: DiagnosedFault, before: Array, settings: RetuneSettings) -> Array:
    """Return the largest sensitivities ``(k,)`` of the `possible_faults` with Q; a loop that has a larger one without Q, ``before (k,)``, may keep it."""
    largest = [settings.sensitivity if found.fault in case else max(settings.sensitivity_if_wrong) for case in possible_faults(problem, found)]
    return np.maximum(largest, before)


def _model(problem: DetectionProblem, severities: Mapping[str, float]) -> StateSpace:
    """Return the loop with J_K from what adds to the outputs, and alpha, to the outputs, and beta."""
    g, noise = problem.augmented.close(severities), problem.covariance if problem.output_cov is None else problem.output_cov
    p, m = g.outputs, g.inputs
    unit = np.diag(np.sqrt(np.diag(noise)))
    B = np.hstack([np.zeros((g.order, p)), g.B])
    C, D = np.vstack([np.linalg.solve(unit, g.C), g.C]), np.block([[np.eye(p), np.linalg.solve(unit, g.D)], [unit, g.D]])
    return star(StateSpace(g.A, B, C, D, g.dt), problem.interconnection, p, m)


def hypothetical_deviations(problem: DetectionProblem, found: DiagnosedFault, cost: LoopCost, Q: StateSpace) -> Array:
    """Return standard deviations of inputs, reported and true outputs with Q in all `possible_faults`, ``(k, m + 2 p)``."""
    return np.array([np.sqrt(np.diag(output_covariance(with_q(signal_model(problem, cost, case), Q)))) for case in possible_faults(problem, found)])


def accepted_deviations(problem: DetectionProblem, before: Array, settings: RetuneSettings) -> Array:
    """Return the largest standard deviations ``(k, m + 2 p)`` with Q: noise peaks keep the limits; a signal that has a larger one without Q, ``before``, may keep it."""
    if problem.limits is None:
        return np.full_like(before, np.inf)
    m, p = problem.plant.inputs, problem.plant.outputs
    u, y = np.broadcast_to(problem.limits.input, m), np.broadcast_to(problem.limits.output, p)
    return np.maximum(FILLED * np.concatenate([u, y, y]) / settings.noise_peak, before)


@dataclass(frozen=True, slots=True, eq=False)
class Priced:
    """A cost over models, and a price on what is beyond its bound in the loops of all `possible_faults` (exterior penalty).

    Due are ``price`` times the integral over log frequency of ``(gain / bound - 1)^2`` for every sensitivity, and times the square of
    ``deviation / bound - 1`` for every signal.
    """

    cost: ModelSet
    loops: ModelSet
    signals: ModelSet
    sensitivity: Array
    deviation: Array
    price: float

    @classmethod
    def of(cls, costs: ModelSet, problem: DetectionProblem, found: DiagnosedFault, cost: LoopCost, bounds: tuple[Array, Array], price: float) -> Priced:
        """Return ``costs`` with the price on what is beyond ``bounds``: of sensitivities ``(k,)`` and of standard deviations ``(k, m + 2 p)``."""
        cases, m, p = possible_faults(problem, found), problem.plant.inputs, problem.plant.outputs
        loops = model_set([_model(problem, case) for case in cases], np.ones(len(cases)), m, p, 1.0)
        signals = model_set([signal_model(problem, cost, case) for case in cases], np.ones(len(cases)), m, p, 1.0)
        return cls(costs, loops, signals, *bounds, price)

    def cost_and_slope(self, Q: StateSpace) -> tuple[float, Array]:
        """Return the sum and its slope in ``[Dq Cq; Bq Aq]``; (inf, 0) where a pole is beyond its bound."""
        value, slope = self.cost.cost_and_slope(Q)
        for part in (self._sensitive, self._beyond_limits):
            if not np.isfinite(value):
                break
            more, steeper = part(Q)
            value, slope = value + self.price * more, slope + self.price * steeper
        return (value, slope) if np.isfinite(value) else (value, np.zeros_like(slope))

    def _beyond_limits(self, Q: StateSpace) -> tuple[float, Array]:
        """Return the squares of the excess of standard deviations and their slope."""

        def excess(variances: Array) -> tuple[float, Array]:
            sd = np.sqrt(variances)
            beyond = np.maximum(sd / self.deviation - 1, 0.0)
            return float((beyond**2).sum()), np.where(beyond > 0, beyond / np.maximum(sd, 1e-300) / self.deviation, 0.0)

        return self.signals.priced(Q, excess) if np.isfinite(self.deviation).any() else (0.0, np.zeros(1))

    def _sensitive(self, Q: StateSpace) -> tuple[float, Array]:
        """Return the integrals of the squared excess of sensitivities and their slope."""
        value, slope = 0.0, np.zeros((Q.outputs + Q.order, Q.inputs + Q.order))
        for bound, A, B, C, D, into, out, Dzu, Dyw in zip(self.sensitivity, *self.loops.closed(Q), strict=True):
            poles = np.linalg.eigvals(A)
            if np.abs(poles).max(initial=0.0) >= 1:
                return float("inf"), slope
            omega = np.unique(np.clip(np.concatenate([FREQUENCIES, np.abs(np.angle(poles))]), FREQUENCIES[0], FREQUENCIES[-1]))
            widths, points = np.gradient(np.log(omega)), np.exp(1j * omega)
            response = transfer(StateSpace(A, B, C, D, Q.dt), points)
            suspect = np.linalg.norm(response, axis=(1, 2)) > bound  # the Frobenius norm is never below the largest singular value
            widths, points, (u, s, vh) = widths[suspect], points[suspect], np.linalg.svd(response[suspect])
            over = s[:, 0] > bound
            beyond, widths = s[over, 0] / bound - 1, widths[over]
            left = u[over, :, :1].conj().swapaxes(1, 2) @ transfer(StateSpace(A, into, C, Dzu, Q.dt), points[over])
            right = transfer(StateSpace(A, B, out, Dyw, Q.dt), points[over]) @ vh[over, :1].conj().swapaxes(1, 2)
            value += float(widths @ beyond**2)
            slope = slope + 2 / bound * np.einsum("k,kai,kja->ij", widths * beyond, left, right).real
        return value, slope
