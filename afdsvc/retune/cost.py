"""The H2 cost of loops with Q: models of the damaged machine, their cost and its slope in the matrices of Q, and the best of all controllers.

Every model is the plant with a fault, in loop with J_K: inputs ``[w, alpha]``, outputs ``[z, beta]``, where ``w`` is unit white noise
and ``E|z|^2`` the cost. Q closes it from beta to alpha. Its feedthrough from alpha to beta is zero for a plant without feedthrough,
so all closed matrices are affine in ``Theta = [Dq Cq; Bq Aq]`` and the slope follows from two Lyapunov equations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from afdsvc.api.detection import DetectionProblem
from afdsvc.api.retuning import LoopCost
from afdsvc.errors import BadInput, Refused
from afdsvc.lti.lft import star
from afdsvc.lti.norms import output_covariance
from afdsvc.lti.riccati import covariance, lqr
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.whitening import innovations

WEIGHTS = ("state_weight", "input_weight", "process_weight")
ROUNDING = 1e-12  # of the largest entry of a weight: less asymmetry than this is that of a product such as B B'
DOUBLINGS = 40  # of the Lyapunov sums: 2^40 samples


def loop_cost(problem: DetectionProblem, settings: Mapping[str, Any]) -> LoopCost:
    """Return the cost with the weights an LQG controller is designed with, and the sensor noise of the machine.

    ``settings`` may hold ``state_weight``, ``input_weight`` and ``process_weight`` (a number, a diagonal or a matrix). Without them the
    outputs and the inputs count alike and a unit disturbance acts on every input, or the stated process noise where there is one.

    >>> from afdsvc.testing.machines import bearing_problem
    >>> loop_cost(bearing_problem(), {"input_weight": 2.0}).input.tolist()
    [[2.0, 0.0], [0.0, 2.0]]
    """
    for key in settings:
        if key not in WEIGHTS:
            raise BadInput(f"cost of a loop: unknown setting '{key}'; known are {', '.join(WEIGHTS)}")
    g = problem.plant
    process = g.B @ g.B.T if problem.process_cov is None else problem.process_cov
    noise = problem.covariance if problem.output_cov is None else problem.output_cov
    return LoopCost(
        _weight("state_weight", settings.get("state_weight", g.C.T @ g.C), g.order),
        _weight("input_weight", settings.get("input_weight", 1.0), g.inputs),
        _weight("process_weight", settings.get("process_weight", process), g.order),
        covariance("the covariance of the sensor noise", noise, g.outputs),
    )


def _weight(name: str, value: Any, n: int) -> Array:
    array = np.asarray(value, dtype=float)
    array = np.diag(array) if array.ndim == 1 else array
    if array.shape == (n, n) and np.abs(array - array.T).max(initial=0.0) < ROUNDING * np.abs(array).max(initial=0.0):
        array = (array + array.T) / 2
    return covariance(name, array, n, definite=False)


def damaged_model(problem: DetectionProblem, cost: LoopCost, severities: Mapping[str, float]) -> StateSpace:
    """Return the loop with J_K, ``[w, alpha] -> [z, beta]``; raises `Refused` for a plant with feedthrough."""
    g = _strictly_proper(problem, severities)
    n, m, p = g.order, g.inputs, g.outputs
    Bw = np.hstack([_root(cost.process), np.zeros((n, p))])
    C = np.vstack([_root(cost.state).T, np.zeros((m, n)), g.C])
    D = np.zeros((n + m + p, n + p + m))
    D[n : n + m, n + p :], D[n + m :, n : n + p] = _root(cost.input).T, _root(cost.noise)
    return star(StateSpace(g.A, np.hstack([Bw, g.B]), C, D, g.dt), problem.interconnection, p, m)


def signal_model(problem: DetectionProblem, cost: LoopCost, severities: Mapping[str, float]) -> StateSpace:
    """Return the same loop with the signals that have limits as outputs, ``[w, alpha] -> [u, y reported, y true, beta]``."""
    g, healthy = _strictly_proper(problem, severities), problem.plant
    n, m, p = g.order, g.inputs, g.outputs
    Bw = np.hstack([_root(cost.process), np.zeros((n, p))])
    C = np.vstack([np.zeros((m, n)), g.C, healthy.C, g.C])
    D = np.zeros((m + 3 * p, n + p + m))
    D[:m, n + p :], D[m : m + p, n : n + p], D[m + 2 * p :, n : n + p] = np.eye(m), _root(cost.noise), _root(cost.noise)
    return star(StateSpace(g.A, np.hstack([Bw, g.B]), C, D, g.dt), problem.interconnection, p, m)


def deviations(signals: StateSpace, m: int, p: int) -> Array:
    """Return standard deviations of inputs and outputs ``(m + p,)``: of outputs the larger of what sensors report and what is."""
    sd = np.sqrt(np.diag(output_covariance(signals)))
    return np.concatenate([sd[:m], np.maximum(sd[m : m + p], sd[m + p : m + 2 * p])])


def with_q(model: StateSpace, Q: StateSpace, gain: float = 1.0) -> StateSpace:
    """Return a model closed by ``alpha = gain Q beta``, from w to its other outputs."""
    scaled = StateSpace(Q.A, Q.B, gain * Q.C, gain * Q.D, model.dt)
    return star(model, scaled, Q.inputs, Q.outputs)


def h2_cost(loop: StateSpace) -> float:
    """Return ``E|z|^2`` per sample for unit white noise, inf for an unstable loop."""
    return float(np.trace(output_covariance(loop))) if is_stable(loop.A, loop.dt) else float("inf")


def best_controller(problem: DetectionProblem, cost: LoopCost, severities: Mapping[str, float]) -> StateSpace:
    """Return the LQG controller of the damaged plant: no linear controller has a smaller cost there.

    ``u = F (x^ + P C' Xi^-1 e)`` uses the newest sample, with the predictor ``x^+ = A x^ + B u + Kp e``, ``e = y - C x^`` (Anderson and
    Moore, *Optimal Filtering*, 1979). Raises `IllConditioned` where the damaged plant cannot be held at all.
    """
    g = _strictly_proper(problem, severities)
    F = lqr(g, cost.state, cost.input)
    seen = innovations(g, cost.noise, cost.process)
    newest = F @ seen.state_covariance @ g.C.T @ np.linalg.inv(seen.covariance)
    B = seen.gain + g.B @ newest
    return StateSpace(g.A + g.B @ F - B @ g.C, B, F - newest @ g.C, newest, g.dt)


def controlled_cost(problem: DetectionProblem, cost: LoopCost, severities: Mapping[str, float], K: StateSpace) -> float:
    """Return the cost of the damaged plant with any controller K in place of the running one; inf where it is unstable."""
    g = _strictly_proper(problem, severities)
    open_loop = StateSpace.gain(np.block([[np.zeros((g.inputs, g.outputs)), np.eye(g.inputs)], [np.eye(g.outputs), np.zeros((g.outputs, g.inputs))]]), g.dt)
    return h2_cost(with_q(damaged_model(_reconnected(problem, open_loop), cost, severities), K))


def _reconnected(problem: DetectionProblem, J: StateSpace) -> DetectionProblem:
    return replace(problem, interconnection=J)


def _strictly_proper(problem: DetectionProblem, severities: Mapping[str, float]) -> StateSpace:
    g = problem.augmented.close(severities)
    if np.abs(g.D).max(initial=0.0) > 0:
        raise Refused("the plant has a direct term D; Q beside J_K is for plants whose output answers after a sample at the earliest")
    return g


def _root(M: Array) -> Array:
    """Return L with ``L L' = M`` for a positive semidefinite matrix, also when its entries differ by many orders."""
    size = np.sqrt(np.diag(M))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(M / np.outer(size, size))
    return np.asarray(size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class ModelSet:
    """k models of one order n, as stacked matrices, with weights ``(k,)`` of their costs; see `model_set`."""

    A: Array
    Bw: Array
    Bu: Array
    Cz: Array
    Cy: Array
    Dzw: Array
    Dzu: Array
    Dyw: Array
    weights: Array
    largest_pole: float

    def cost_and_slope(self, Q: StateSpace) -> tuple[float, Array]:
        """Return the weighted cost with Q and its slope in ``[Dq Cq; Bq Aq]``; see `priced`."""
        return self.priced(Q, lambda variances: (float(self.weights @ variances.sum(axis=1)), np.broadcast_to(self.weights[:, None], variances.shape)))

    def priced(self, Q: StateSpace, price: Callable[[Array], tuple[float, Array]]) -> tuple[float, Array]:
        """Return a price on the variances ``(k, z)`` of the outputs with Q and its slope in ``[Dq Cq; Bq Aq]``; (inf, 0) where a pole is beyond ``largest_pole``.

        ``price`` returns its value and its derivatives ``(k, z)``. Variances are those of ``A / largest_pole``: they rise without bound as a pole
        approaches that modulus, and bound the true ones.
        """
        A, B, C, D, into, out, Dzu, Dyw = self.closed(Q)
        A = A / self.largest_pole
        if max(float(np.abs(np.linalg.eigvals(a)).max()) for a in A) >= 1:
            return float("inf"), np.zeros((into.shape[2], out.shape[1]))
        P = _lyapunov(A, B @ _t(B))
        value, each = price(np.einsum("kzi,kij,kzj->kz", C, P, C, optimize=True) + (D**2).sum(axis=2))
        due = each[:, :, None]
        X = _lyapunov(_t(A), _t(C) @ (due * C))
        slopes = _t(into) @ X @ (A @ P @ _t(out) / self.largest_pole + B @ _t(Dyw)) + _t(Dzu) @ (due * (C @ P @ _t(out) + D @ _t(Dyw)))
        return value, 2 * slopes.sum(axis=0)

    def closed(self, Q: StateSpace) -> tuple[Array, ...]:
        """Return A, B, C, D of the loops with Q, and the factors of their slopes: ``dA = into dTheta out``, ``dB = into dTheta Dyw``,
        ``dC = Dzu dTheta out``, ``dD = Dzu dTheta Dyw``."""
        theta = np.block([[Q.D, Q.C], [Q.B, Q.A]])
        q, m, p = Q.order, Q.outputs, Q.inputs

        def grown(M: Array, rows: int, columns: int) -> Array:
            return np.pad(M, ((0, 0), (0, rows), (0, columns)))

        into = grown(self.Bu, q, q)
        into[:, self.A.shape[1] :, m:] = np.eye(q)
        out = grown(self.Cy, q, q)
        out[:, p:, self.A.shape[1] :] = np.eye(q)
        Dzu, Dyw = grown(self.Dzu, 0, q), grown(self.Dyw, q, 0)
        A, B = grown(self.A, q, q) + into @ theta @ out, grown(self.Bw, q, 0) + into @ theta @ Dyw
        C, D = grown(self.Cz, 0, q) + Dzu @ theta @ out, self.Dzw + Dzu @ theta @ Dyw
        return A, B, C, D, into, out, Dzu, Dyw


def model_set(models: Sequence[StateSpace], weights: ArrayLike, inputs: int, outputs: int, largest_pole: float) -> ModelSet:
    """Return models ``[w, alpha] -> [z, beta]`` with m = ``inputs`` alphas and p = ``outputs`` betas, stacked."""
    w, z = models[0].inputs - inputs, models[0].outputs - outputs

    def stacked(name: str, rows: slice, columns: slice) -> Array:
        return np.stack([getattr(s, name)[rows, columns] for s in models])

    every, into, by = slice(None), slice(w, None), slice(z, None)
    return ModelSet(
        stacked("A", every, every), stacked("B", every, slice(w)), stacked("B", every, into), stacked("C", slice(z), every),
        stacked("C", by, every), stacked("D", slice(z), slice(w)), stacked("D", slice(z), into), stacked("D", by, slice(w)),
        np.asarray(weights, dtype=float), largest_pole,
    )  # fmt: skip


def _lyapunov(A: Array, V: Array) -> Array:
    """Return P of ``P = A P A' + V`` for stable stacked A, by doubling the number of summands."""
    P = V
    for _ in range(DOUBLINGS):
        P = P + A @ P @ _t(A)
        A = A @ A
        if np.abs(A).max() < 1e-9:
            break
    return P


def _t(M: Array) -> Array:
    return np.swapaxes(M, 1, 2)
