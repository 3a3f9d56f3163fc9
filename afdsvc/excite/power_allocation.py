"""Allocation of power to inputs and frequencies by a linear programme.

Squared deflections and (at least) squared separations add up over lines, and so do mean squares at outputs and
actuators. With ``x_c >= 0`` the squared amplitude of candidate c,

    maximise t   subject to   sum_c gain[i, c] x_c / required_i^2 >= t,   sum_c price[b, c] x_c <= budget_b

gives the burst of ``1 / t`` samples in which every fault reaches its required deflection and every pair its required
separation. A vertex of the programme uses no more lines than there are active constraints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from afdsvc.api.bursts import Line
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.features.demodulation import coefficients
from afdsvc.detect.features.regressors import whitener
from afdsvc.detect.statistics.fault_curves import loop_response
from afdsvc.errors import Refused
from afdsvc.lti.statespace import Array

NEGLIGIBLE = 1e-6  # share of the largest power below which a line is dropped


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Unit lines at L frequencies on m inputs, flattened to ``C = L m`` columns.

    ``deflection (K, C)``: squared deflection per sample of every fault. ``separation (pairs, C)``: squared separation
    per sample of every ordered pair in ``pairs``. ``output (p, C)`` and ``input (m, C)``: mean squares.
    """

    omega: Array
    inputs: Array
    deflection: Array
    separation: Array
    pairs: tuple[tuple[int, int], ...]
    output: Array
    input: Array


def candidates(problem: DetectionProblem, omega: Sequence[float] | Array, severity: float) -> Candidates:
    """Return the candidates for faults of one severity, disturbances those of the healthy machine."""
    w = np.asarray(omega, dtype=float)
    loop, Li, m = loop_response(problem, w), whitener(problem.covariance), problem.plant.inputs
    waves = []
    for fault in problem.fault_names:
        r = np.einsum("pq,lqm->lmp", Li, loop.paths(fault, [severity]).r[0])
        waves.append(coefficients(r[:, :, None, :]).reshape(len(w) * m, -1))
    pairs = tuple((a, b) for a in range(len(waves)) for b in range(len(waves)) if a != b)
    apart = [0.5 * beside(waves[a], waves[b]) for a, b in pairs]
    healthy = loop.healthy()
    return Candidates(
        np.repeat(w, m), np.tile(np.arange(m), len(w)),
        np.array([0.5 * np.sum(v**2, axis=-1) for v in waves]), np.array(apart).reshape(len(pairs), len(w) * m), pairs,
        0.5 * _columns(np.abs(healthy.y[0]) ** 2), 0.5 * _columns(np.abs(healthy.u[0]) ** 2),
    )


def beside(a: Array, b: Array) -> Array:
    """Return the squared length of what a has beside the direction of b, along the last axis."""
    along, length = np.sum(a * b, axis=-1), np.sum(b * b, axis=-1)
    return np.asarray(np.maximum(np.sum(a * a, axis=-1) - along**2 / np.maximum(length, 1e-300), 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Allocation:
    """Lines that use the budget best, the samples the burst then needs, and how tight each wish is.

    ``slack`` holds, for every fault and pair, its squared deflection or separation over the required one after
    ``samples``: 1 for those that decide the length.
    """

    lines: tuple[Line, ...]
    samples: float
    slack: Array


def allocate(found: Candidates, required: Array, budgets: Sequence[tuple[Array, float]]) -> Allocation:
    """Return the best split of the budgets.

    ``required (K + pairs,)`` are deflections and separations (0: not asked for), ``budgets`` pairs of prices ``(C,)``
    and their bound, for example mean square output and actuator voltage. Raises `Refused` naming a wish that no line
    serves.
    """
    gains = np.vstack([found.deflection, found.separation])
    asked = np.flatnonzero(np.asarray(required) > 0)
    gains, goals = gains[asked], np.asarray(required, dtype=float)[asked] ** 2
    scale = np.max(gains, axis=1)
    if not len(asked) or (scale <= 0).any():
        dead = asked[np.flatnonzero(scale <= 0)].tolist()
        raise Refused(f"no line on any input shows {dead} (indices of faults, then of pairs of faults); leave them out")
    prices = np.array([price / bound for price, bound in budgets])
    x = _solve(gains / goals[:, None], prices)
    x = np.where(x > NEGLIGIBLE * x.max(), x, 0.0)
    x = x / np.max(prices @ x)
    reach = gains @ x / goals
    lines = tuple(
        Line(int(found.inputs[c]), float(found.omega[c]), float(np.sqrt(x[c]))) for c in np.flatnonzero(x)
    )
    return Allocation(lines, float(1 / reach.min()), reach / reach.min())


def _solve(gains: Array, prices: Array) -> Array:
    """Return the powers of the programme, its columns scaled to their price so that the numbers stay near one."""
    unit = 1 / np.maximum(prices.max(axis=0), 1e-300)
    rows, columns = gains.shape
    g = gains * unit
    top = g.max()
    A = np.vstack([
        np.hstack([-g / top, np.ones((rows, 1))]),
        np.hstack([prices * unit, np.zeros((len(prices), 1))]),
    ])  # fmt: skip
    b = np.concatenate([np.zeros(rows), np.ones(len(prices))])
    cost = np.zeros(columns + 1)
    cost[-1] = -1.0
    solved = linprog(cost, A_ub=A, b_ub=b, bounds=[(0, None)] * (columns + 1), method="highs")
    if not solved.success:
        raise Refused(f"the budget cannot be split: {solved.message}")
    powers: Array = np.asarray(solved.x, dtype=np.float64)[:-1] * unit
    return powers


def _columns(a: Array) -> Array:
    """Return ``(L, rows, m)`` as ``(rows, L m)``."""
    return np.moveaxis(a, 1, 0).reshape(a.shape[1], -1)
