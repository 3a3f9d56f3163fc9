"""Q for a damaged machine: as good as the damage allows over the interval of the severity, stable also where there is no damage.

Start: the LQG controllers of several severities, each realised exactly as a Q. The best of them that every model survives is improved by
descent on the cost over all models, the healthy machine among them with the weight of the doubt, and on a rising price of sensitivities and signals
beyond their bounds. Its order is then lowered as far as the reduction of the cost allows.

Sources: D. C. Youla, H. A. Jabr and J. J. Bongiorno, "Modern Wiener-Hopf design of optimal controllers", IEEE Trans. AC 21, 1976;
H. Niemann and J. Stoustrup, "Reliable control using the primary and dual Youla parameterizations", CDC 2002.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from afdsvc.api.detection import DetectionProblem
from afdsvc.api.retuning import DiagnosedFault, LoopCost
from afdsvc.errors import AfdsvcError, BadInput, Refused
from afdsvc.lti.lft import star
from afdsvc.lti.reduce import balanced_truncation, weighted_truncation
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.yjbk import retuned_interconnection, youla_parameter
from afdsvc.retune.bounds import (
    AT_BOUND,
    Priced,
    accepted,
    accepted_deviations,
    hypothetical_deviations,
    possible_faults,
    sensitivities,
)
from afdsvc.retune.cost import ModelSet, best_controller, controlled_cost, damaged_model, h2_cost, model_set, with_q
from afdsvc.retune.settings import RETUNE, RetuneSettings

INSIDE = 0.98  # of a bound: where its price begins, nearer with every attempt, as a peak may lie between two frequencies
PRICE = 0.02  # of a squared excess, in possible reductions of the cost; without it the first search ends where no later price leads back
ROUNDING = 1e-9  # of a signal that Q does not reach
ATTEMPTS = 8  # of keeping the bounds, at ten times the price each
CAUTION = (1.0, 10.0, 100.0, 1000.0)  # factors on input weight and sensor noise: start from controllers of lower gain, which more machines bear


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """Costs per sample at severities ``(k,)``: ``before`` without Q, ``after`` with it, ``best`` of the LQG controller of that very plant."""

    severities: Array
    before: Array
    after: Array
    best: Array

    @property
    def reached(self) -> Array:
        """Share of the possible reduction that Q reaches, ``(k,)``."""
        return np.asarray((self.before - self.after) / (self.before - self.best), dtype=np.float64)


def design_q(problem: DetectionProblem, found: DiagnosedFault, cost: LoopCost, settings: RetuneSettings = RETUNE) -> StateSpace:
    """Return Q ``(m, p)`` for the diagnosed fault, of the lowest order that loses less than ``order_loss`` of the reduction.

    Raises `Refused` when nothing worthwhile can be gained, when the running controller does not hold the damaged machine, and when no
    controller holds it.

    >>> from afdsvc.testing.machines import bearing_problem
    >>> from afdsvc.retune.cost import loop_cost
    >>> machine = bearing_problem("proportional")
    >>> design_q(machine, DiagnosedFault("horizontal_actuator", -0.5, -0.4), loop_cost(machine, {})).is_stable()
    True
    """
    require_alpha(problem)
    search = _Search.of(problem, found, cost, settings)
    designs: list[StateSpace] = []
    for bound in settings.sensitivity_if_wrong:
        Q, at_bound = search.within(bound)
        designs.append(Q)
        if search.enough(Q) or not at_bound:
            break
    Q = max(designs, key=search.enough)  # the first where none is enough
    gained = 1 - float(np.max(search.after(Q) / search.before))
    if gained < settings.worthwhile:
        raise Refused(
            f"'{found.fault}': nothing to gain; within limits, sensitivity and stability of the healthy machine Q changes the cost by {-100 * gained:.2g} %"
        )
    return Q


def severity_grid(problem: DetectionProblem, found: DiagnosedFault, count: int) -> Array:
    """Return severities over the interval, ends included; raises `BadInput` for an unknown fault or a severity out of range."""
    low, high = problem.severity_range
    if found.fault not in problem.fault_names:
        raise BadInput(f"fault '{found.fault}' is unknown; this machine has {', '.join(problem.fault_names)}")
    if not (low <= found.low and found.high <= high):
        raise BadInput(f"fault '{found.fault}': severity {found.low:g} to {found.high:g}; expected {low:g} to {high:g}")
    return np.linspace(found.low, found.high, count if found.high > found.low else 1)


def expected(problem: DetectionProblem, found: DiagnosedFault, cost: LoopCost, Q: StateSpace, count: int = RETUNE.models) -> Expected:
    """Return the costs over the interval without and with Q, and what the best controller for every severity reaches."""
    grid = severity_grid(problem, found, count)
    rows = [_costs(problem, found.fault, s, cost, Q) for s in grid.tolist()]
    before, after, best = np.array(rows).T
    return Expected(grid, before, after, best)


def _costs(problem: DetectionProblem, fault: str, severity: float, cost: LoopCost, Q: StateSpace) -> tuple[float, float, float]:
    model = damaged_model(problem, cost, {fault: severity})
    K = best_controller(problem, cost, {fault: severity})
    return h2_cost(with_q(model, _zero(problem))), h2_cost(with_q(model, Q)), controlled_cost(problem, cost, {fault: severity}, K)


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """A search for Q: models of the damaged machine with their costs ``before (k,)`` and ``best (k,)``, starts, and the cost over all models."""

    problem: DetectionProblem
    found: DiagnosedFault
    cost: LoopCost
    settings: RetuneSettings
    models: Sequence[StateSpace]
    before: Array
    best: Array
    starts: Sequence[StateSpace]
    costs: ModelSet

    @classmethod
    def of(cls, problem: DetectionProblem, found: DiagnosedFault, cost: LoopCost, settings: RetuneSettings) -> _Search:
        """Return the search; raises `Refused` where nothing can be gained or held."""
        fault, grid, none = found.fault, severity_grid(problem, found, settings.models), _zero(problem)
        models = [damaged_model(problem, cost, {fault: s}) for s in grid.tolist()]
        before = np.array([h2_cost(with_q(model, none)) for model in models])
        if not np.isfinite(before).all():
            raise Refused(f"the running controller does not hold the machine with '{fault}' at {100 * grid[~np.isfinite(before)][0]:.3g} %")
        controllers = [best_controller(problem, cost, {fault: s}) for s in grid.tolist()]
        best = np.array([controlled_cost(problem, cost, {fault: s}, K) for s, K in zip(grid.tolist(), controllers, strict=True)])
        if not (before - best > settings.worthwhile * before).all():
            share = 100 * float(np.min(1 - best / before))
            raise Refused(f"'{fault}': nothing to gain; the best controller lowers the cost by {share:.2g} % (below {100 * settings.worthwhile:g} %)")
        healthy = damaged_model(problem, cost, {})
        least = controlled_cost(problem, cost, {}, best_controller(problem, cost, {}))
        if not least > 0:
            raise Refused(f"'{fault}': nothing to gain; without disturbances the best controller of the healthy machine does nothing and costs nothing")
        weights = np.concatenate([1 / (before - best) / len(grid), [settings.doubt / least]])
        margin = min(with_q(model, none).stability_margin() for model in (*models, healthy))
        costs = model_set([*models, healthy], weights, problem.plant.inputs, problem.plant.outputs, 1 - settings.margin_kept * margin)
        cautious = [replace(cost, input=c * cost.input, noise=c * cost.noise) for c in CAUTION]
        others = [best_controller(problem, c, {fault: s}) for c in cautious for s in (float(grid[len(grid) // 2]), 0.0)]
        starts = [youla_parameter(problem.interconnection, K) for K in (*controllers, *others)]
        starts = [_minimal(Q) for Q in starts if is_stable(Q.A, Q.dt)]
        if not starts:
            raise Refused(f"'{fault}': no controller of the damaged machine also holds the healthy one")
        starts += [replace(Q, C=gain * Q.C, D=gain * Q.D) for gain in (0.5, 0.0) for Q in starts]
        return cls(problem, found, cost, settings, models, before, best, starts, costs)

    def after(self, Q: StateSpace) -> Array:
        """Return the costs with Q, ``(k,)``."""
        return np.array([h2_cost(with_q(model, Q)) for model in self.models])

    def enough(self, Q: StateSpace) -> bool:
        """Return whether Q reaches ``enough`` of the possible reduction, in the mean over the interval."""
        return bool(np.mean((self.before - self.after(Q)) / (self.before - self.best)) >= self.settings.enough)

    def within(self, bound: float) -> tuple[StateSpace, bool]:
        """Return the Q of least cost within limits and bounds, the sensitivity where the diagnosis is wrong within ``bound``, and whether that one binds.

        Every attempt goes on from the last with a higher price on what is beyond its bound, so that searches from different starts meet.
        """
        problem, found, settings = self.problem, self.found, replace(self.settings, sensitivity_if_wrong=(bound,))
        none, price, Q = _zero(problem), PRICE, None
        most = accepted(problem, found, sensitivities(problem, found, none)[:, 0], settings)
        largest = accepted_deviations(problem, hypothetical_deviations(problem, found, self.cost, none), settings)
        wrong = np.array([found.fault not in case for case in possible_faults(problem, found)])

        def beyond(Q: StateSpace) -> bool:
            return bool((sensitivities(problem, found, Q)[:, 1] > most).any() or (hypothetical_deviations(problem, found, self.cost, Q) > (1 + ROUNDING) * largest).any())

        for inside in INSIDE ** np.arange(1, ATTEMPTS + 1):
            fit = Priced.of(self.costs, problem, found, self.cost, (inside * most, inside * largest), price)
            Q = descended(fit, self._start(fit) if Q is None else Q, settings.iterations)
            if not beyond(Q) and not beyond(lower := self._of_lowest_order(fit, Q)):
                return lower, bool((sensitivities(problem, found, Q)[:, 1] > AT_BOUND * inside * most)[wrong].any())
            price *= 10
        return none, True

    def _start(self, fit: Priced) -> StateSpace:
        """Return the cheapest of the starts, over all models."""
        return min(self.starts, key=lambda Q: fit.cost_and_slope(Q)[0])

    def _of_lowest_order(self, fit: Priced, full: StateSpace) -> StateSpace:
        """Return the Q of lowest order that loses at most ``order_loss`` of the reduction by ``full``, and is enough where that is."""
        without, reached = (fit.cost_and_slope(Q)[0] for Q in (_zero(self.problem), full))
        allowed, necessary = reached + self.settings.order_loss * (without - reached), self.enough(full)
        loop = _with_alpha(self.models[len(self.models) // 2], full)
        z, w = self.models[0].outputs - full.inputs, self.models[0].inputs - full.outputs
        to_cost, from_noise = loop.select(slice(z), slice(w, None)), loop.select(slice(z, None), slice(w))
        for order in range(full.order):
            try:
                lower = weighted_truncation(full, order, to_cost, from_noise).system
            except AfdsvcError:
                continue
            if is_stable(lower.A, lower.dt) and fit.cost_and_slope(lower)[0] <= allowed:
                lower = descended(fit, lower, self.settings.iterations)
                if self.enough(lower) or not necessary:
                    return lower
        return full


def _minimal(Q: StateSpace) -> StateSpace:
    """Return Q in balanced states, without those that neither inputs nor outputs see."""
    return balanced_truncation(Q, tolerance=1e-9).system


def descended(fit: Priced, Q: StateSpace, iterations: int) -> StateSpace:
    """Return Q after a descent (BFGS) on the cost over all models; a step to an unstable loop is never taken."""
    shape, m, p = (Q.outputs + Q.order, Q.inputs + Q.order), Q.outputs, Q.inputs

    def unpacked(x: Array) -> StateSpace:
        theta = x.reshape(shape)
        return StateSpace(theta[m:, p:], theta[m:, :p], theta[:m, p:], theta[:m, :p], Q.dt)

    start = np.block([[Q.D, Q.C], [Q.B, Q.A]]).ravel()
    first = fit.cost_and_slope(Q)[0]

    def cost(x: Array) -> tuple[float, Array]:
        value, slope = fit.cost_and_slope(unpacked(x))
        return (value / first, slope.ravel() / first) if np.isfinite(value) else (1e6, slope.ravel())

    done = minimize(cost, start, jac=True, method="BFGS", options={"maxiter": iterations})
    return unpacked(done.x) if done.fun < 1 else Q


def _with_alpha(model: StateSpace, Q: StateSpace) -> StateSpace:
    """Return a model with Q in place and alpha still an input: ``[w, alpha] -> [z, beta]``."""
    m, p = Q.outputs, Q.inputs
    beside = StateSpace(
        Q.A, np.hstack([Q.B, np.zeros((Q.order, m))]), np.vstack([Q.C, np.zeros((p, Q.order))]),
        np.block([[Q.D, np.eye(m)], [np.eye(p), np.zeros((p, m))]]), model.dt,
    )  # fmt: skip
    return star(model, beside, p, m)


def retuned_problem(problem: DetectionProblem, Q: StateSpace) -> DetectionProblem:
    """Return what detectors, thresholds and bursts are designed for while Q runs: the same residual, in the loop with Q."""
    require_alpha(problem)
    return replace(problem, interconnection=retuned_interconnection(problem.interconnection, Q))


def require_alpha(problem: DetectionProblem) -> None:
    """Raise `Refused` where bursts enter through references: Q acts where alpha does."""
    if problem.through != "alpha":
        raise Refused(f"machine '{problem.machine}' is excited through its references (bursts.through = '{problem.through}'); Q needs 'alpha'")


def _zero(problem: DetectionProblem) -> StateSpace:
    return StateSpace.gain(np.zeros((problem.plant.inputs, problem.plant.outputs)), problem.plant.dt)
