"""Q for a damaged machine: as good as the damage allows over the interval of the severity, stable also where there is no damage.

Start: the LQG controllers of several severities, each realised exactly as a Q. The best of them that every model survives is improved by
descent on the cost over all models, the healthy machine among them with the weight of the doubt. Its order is then lowered as
far as the reduction of the cost allows.

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
from afdsvc.lti.norms import output_covariance
from afdsvc.lti.reduce import balanced_truncation, weighted_truncation
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.yjbk import retuned_interconnection, youla_parameter
from afdsvc.retune.cost import (
    best_controller,
    controlled_cost,
    damaged_model,
    h2_cost,
    model_set,
    signal_model,
    with_q,
)
from afdsvc.retune.sensitivity import AT_BOUND, Priced, accepted, hypotheses, sensitivities
from afdsvc.retune.settings import RETUNE, RetuneSettings

TIGHTER = 2.0  # factor on the price of a signal beyond its limit
INSIDE = 0.98  # of the accepted sensitivity: where its price begins, nearer with every attempt, as a peak may lie between two frequencies
ATTEMPTS = 8  # of making it fit
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
    designs: list[tuple[StateSpace, Expected]] = []
    for bound in settings.sensitivity_if_wrong:
        Q, at_bound = _within_bounds(problem, found, cost, replace(settings, sensitivity_if_wrong=(bound,)))
        designs.append((Q, expected(problem, found, cost, Q, settings.models)))
        if designs[-1][1].reached.mean() >= settings.enough or not at_bound:
            break
    Q, costs = max(designs, key=lambda one: one[1].reached.mean() >= settings.enough)  # the first where none is enough
    gained = 1 - float(np.max(costs.after / costs.before))
    if gained < settings.worthwhile:
        raise Refused(
            f"'{found.fault}': nothing to gain; within limits, sensitivity and stability of the healthy machine Q changes the cost by {-100 * gained:.2g} %"
        )
    return Q


def _within_bounds(problem: DetectionProblem, found: DiagnosedFault, cost: LoopCost, settings: RetuneSettings) -> tuple[StateSpace, bool]:
    """Return the Q of least cost within the limits of signals and the bounds on sensitivity, and whether the bound where the diagnosis is wrong keeps it.

    Each attempt goes on from the last with higher prices.
    """
    grid, none = severity_grid(problem, found, settings.models), _zero(problem)
    weighted, price, peak_price = cost, h2_cost(with_q(damaged_model(problem, cost, {}), none)), 0.0
    most, full = accepted(problem, found, sensitivities(problem, found, none)[:, 0], settings), None
    bounds, wrong = INSIDE * most, np.array([found.fault not in case for case in hypotheses(problem, found)])
    for _ in range(ATTEMPTS):
        Q, full = _designed(problem, found, grid, weighted, (bounds, peak_price), full, settings)
        over, peaks = _over_limit(problem, found.fault, grid, cost, Q, settings), sensitivities(problem, found, Q)[:, 1]
        at_bound, sensitive = bool((peaks > AT_BOUND * bounds)[wrong].any()), (peaks > most).any()
        if not (over or sensitive):
            break
        if over:
            weighted = _tighter(problem, weighted, over, price, settings)
            price *= TIGHTER
        if sensitive:
            peak_price, bounds = max(10 * peak_price, 1.0), INSIDE * bounds
    return Q, at_bound


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


def _designed(
    problem: DetectionProblem,
    found: DiagnosedFault,
    grid: Array,
    cost: LoopCost,
    peaks: tuple[Array, float],
    earlier: StateSpace | None,
    settings: RetuneSettings,
) -> tuple[StateSpace, StateSpace]:
    """Return Q of the lowest order and of full order; ``peaks`` are the bounds on sensitivity and their price, the search goes on from ``earlier``."""
    fault = found.fault
    models = [damaged_model(problem, cost, {fault: s}) for s in grid.tolist()]
    none = _zero(problem)
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
    doubted = settings.doubt / least
    weights = np.concatenate([1 / (before - best) / len(grid), [doubted]])
    every = [*models, healthy]
    margin = min(with_q(model, none).stability_margin() for model in every)
    costs = model_set(every, weights, problem.plant.inputs, problem.plant.outputs, 1 - settings.margin_kept * margin)
    fit = Priced.of(costs, problem, found, *peaks)
    if earlier is None or not np.isfinite(fit.cost_and_slope(earlier)[0]):
        earlier = _start(problem, fault, grid, controllers, cost, fit)
    full = descended(fit, earlier, settings.iterations)
    return _of_lowest_order(fit, full, models, none, settings), full


def _start(
    problem: DetectionProblem, fault: str, grid: Array, controllers: Sequence[StateSpace], cost: LoopCost, fit: Priced
) -> StateSpace:
    """Return the cheapest Q, over all models, among those that realise LQG controllers; zero always survives."""
    cautious = [replace(cost, input=c * cost.input, noise=c * cost.noise) for c in CAUTION]
    middle = float(grid[len(grid) // 2])
    others = [best_controller(problem, c, {fault: s}) for c in cautious for s in (middle, 0.0)]
    candidates = [youla_parameter(problem.interconnection, K) for K in (*controllers, *others)]
    candidates = [_minimal(Q) for Q in candidates if is_stable(Q.A, Q.dt)]
    candidates += [replace(Q, C=Q.C / 2, D=Q.D / 2) for Q in candidates]
    costs = [fit.cost_and_slope(Q)[0] for Q in candidates]
    k = int(np.argmin(costs)) if costs else 0
    if costs and costs[k] < fit.cost_and_slope(_zero(problem))[0]:
        return candidates[k]
    if not candidates:
        raise Refused(f"'{fault}': no controller of the damaged machine also holds the healthy one")
    return replace(candidates[-1], C=0 * candidates[-1].C, D=0 * candidates[-1].D)


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

    done = minimize(cost, start, jac=True, method="L-BFGS-B", options={"maxiter": iterations, "maxcor": 30})
    return unpacked(done.x) if done.fun < 1 else Q


def _of_lowest_order(fit: Priced, full: StateSpace, models: Sequence[StateSpace], none: StateSpace, settings: RetuneSettings) -> StateSpace:
    """Return the Q of lowest order whose weighted cost is within ``order_loss`` of the reduction that ``full`` brings."""
    without, reached = fit.cost_and_slope(none)[0], fit.cost_and_slope(full)[0]
    allowed = reached + settings.order_loss * (without - reached)
    loop = _with_alpha(models[len(models) // 2], full)
    z, w = models[0].outputs - full.inputs, models[0].inputs - full.outputs
    to_cost = loop.select(slice(z), slice(w, None))
    from_noise = loop.select(slice(z, None), slice(w))
    for order in range(full.order):
        try:
            lower = weighted_truncation(full, order, to_cost, from_noise).system
        except AfdsvcError:
            continue
        if is_stable(lower.A, lower.dt) and fit.cost_and_slope(lower)[0] <= allowed:
            return descended(fit, lower, settings.iterations)
    return full


def _with_alpha(model: StateSpace, Q: StateSpace) -> StateSpace:
    """Return a model with Q in place and alpha still an input: ``[w, alpha] -> [z, beta]``."""
    m, p = Q.outputs, Q.inputs
    beside = StateSpace(
        Q.A, np.hstack([Q.B, np.zeros((Q.order, m))]), np.vstack([Q.C, np.zeros((p, Q.order))]),
        np.block([[Q.D, np.eye(m)], [np.eye(p), np.zeros((p, m))]]), model.dt,
    )  # fmt: skip
    return star(model, beside, p, m)


def _over_limit(
    problem: DetectionProblem, fault: str, grid: Array, cost: LoopCost, Q: StateSpace, settings: RetuneSettings
) -> tuple[Array, Array] | None:
    """Return how far inputs ``(m,)`` and outputs ``(p,)`` are beyond their limits (or beyond what they are without Q), None when not at all."""
    limits, m, p = problem.limits, problem.plant.inputs, problem.plant.outputs
    if limits is None:
        return None
    none, worst = _zero(problem), np.zeros(m + p)
    for s in (*grid.tolist(), 0.0):
        model = signal_model(problem, cost, {fault: s})
        now, then = (settings.noise_peak * deviations(with_q(model, q), m, p) for q in (Q, none))
        worst = np.maximum(worst, now / np.maximum(np.concatenate([limits.input, limits.output]), then))
    return None if (worst <= 1).all() else (worst[:m], worst[m:])


def retuned_problem(problem: DetectionProblem, Q: StateSpace) -> DetectionProblem:
    """Return what detectors, thresholds and bursts are designed for while Q runs: the same residual, in the loop with Q."""
    require_alpha(problem)
    return replace(problem, interconnection=retuned_interconnection(problem.interconnection, Q))


def require_alpha(problem: DetectionProblem) -> None:
    """Raise `Refused` where bursts enter through references: Q acts where alpha does."""
    if problem.through != "alpha":
        raise Refused(f"machine '{problem.machine}' is excited through its references (bursts.through = '{problem.through}'); Q needs 'alpha'")


def deviations(signals: StateSpace, m: int, p: int) -> Array:
    """Return standard deviations of inputs and outputs ``(m + p,)``: of outputs the larger of what sensors report and what is."""
    sd = np.sqrt(np.diag(output_covariance(signals)))
    return np.concatenate([sd[:m], np.maximum(sd[m : m + p], sd[m + p : m + 2 * p])])


def _tighter(problem: DetectionProblem, cost: LoopCost, over: tuple[Array, Array], price: float, settings: RetuneSettings) -> LoopCost:
    """Return the cost with a price on the signals beyond their limits: ``price`` is due when noise peaks fill the limit."""
    assert problem.limits is not None  # noqa: S101 - nothing is beyond a limit without limits
    due = [price * (settings.noise_peak / np.asarray(x, dtype=float)) ** 2 for x in (problem.limits.input, problem.limits.output)]
    u, y = np.diag(np.where(over[0] > 1, due[0], 0.0)), np.diag(np.where(over[1] > 1, due[1], 0.0))
    return replace(cost, input=cost.input + u, state=cost.state + problem.plant.C.T @ y @ problem.plant.C)


def _zero(problem: DetectionProblem) -> StateSpace:
    return StateSpace.gain(np.zeros((problem.plant.inputs, problem.plant.outputs)), problem.plant.dt)
