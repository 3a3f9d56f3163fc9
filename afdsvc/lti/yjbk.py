"""The YJBK parametrisation: J_K, J_G, K(Q), G(S), S of a true plant, and every path of the closed loop.

Positive feedback ``u = K y``. All of it is made by solving R = [M U; N V] another way and by closing loops; no factor
is ever inverted or multiplied as a transfer function, so no unstable mode can hide. (Thesis 2.10-2.15 and 4.37,
corrected where docs/explanation/errata.md says so.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afdsvc.errors import BadInput
from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.lft import star
from afdsvc.lti.stability import require_stable, trim
from afdsvc.lti.statespace import Array, StateSpace, solve_loop


def exchange(system: StateSpace, inputs: Sequence[int], outputs: Sequence[int]) -> StateSpace:
    """Return the same relation between signals, solved the other way for the listed pairs.

    Output ``outputs[i]`` becomes the input at position ``inputs[i]`` and the other way round; everything else keeps its
    place. The order does not change. Raises `IllConditioned` when the feedthrough between the pairs is not invertible.
    """
    n = system.order
    rows, cols = n + np.asarray(outputs, np.intp), n + np.asarray(inputs, np.intp)
    M = np.block([[system.A, system.B], [system.C, system.D]])
    pivoted = _pivot(M, rows, cols)
    return StateSpace(pivoted[:n, :n], pivoted[:n, n:], pivoted[n:, :n], pivoted[n:, n:], system.dt)


def _pivot(M: Array, rows: NDArray[np.intp], cols: NDArray[np.intp]) -> Array:
    """Solve ``out = M in`` for the inputs ``cols`` in terms of the outputs ``rows`` (principal pivot transform)."""
    other_rows, other_cols = np.setdiff1d(np.arange(M.shape[0]), rows), np.setdiff1d(np.arange(M.shape[1]), cols)
    inverse = solve_loop(M[np.ix_(rows, cols)])
    out = np.empty_like(M)
    from_rest = -inverse @ M[np.ix_(rows, other_cols)]
    through = M[np.ix_(other_rows, cols)]
    out[np.ix_(rows, cols)] = inverse
    out[np.ix_(rows, other_cols)] = from_rest
    out[np.ix_(other_rows, cols)] = through @ inverse
    out[np.ix_(other_rows, other_cols)] = M[np.ix_(other_rows, other_cols)] + through @ from_rest
    return out


def interconnection(fact: Factorisation) -> StateSpace:
    """Return J_K, the controller with excitation input and residual output: ``[y, alpha] -> [u, beta]`` (thesis 2.11).

    Its order is that of R: n for a static controller or an observer, n + n_K for any other controller.
    """
    m, p = fact.plant.inputs, fact.plant.outputs
    solved = exchange(fact.R, range(m, m + p), range(m, m + p))  # (alpha, y) -> (u, beta)
    return solved.select(slice(None), [*range(m, m + p), *range(m)])


def plant_interconnection(fact: Factorisation) -> StateSpace:
    """Return J_G: ``[eps, u] -> [eta, y]`` (thesis 2.13); ``G(S) = F_u(J_G, S)`` and ``J_G * J_K = [0 I; I 0]``."""
    m, p = fact.plant.inputs, fact.plant.outputs
    solved = exchange(fact.R, range(m), range(m))  # (u, eps) -> (eta, y)
    return solved.select(slice(None), [*range(m, m + p), *range(m)])


def controller_from(fact: Factorisation, Q: StateSpace) -> StateSpace:
    """Return ``K(Q) = (U + M Q)(V + N Q)^-1 = F_l(J_K, Q)`` for a stable Q ``(m, p)`` (thesis 2.10, corrected)."""
    _shape("Q", Q, fact.plant.inputs, fact.plant.outputs)
    require_stable(Q.A, Q.dt, "Q", "only a stable Q keeps the loop stable")
    J = interconnection(fact)
    m, p = fact.plant.inputs, fact.plant.outputs
    return star(J, Q, p, m)


def youla_parameter(J_K: StateSpace, K: StateSpace) -> StateSpace:
    """Return the Q ``(m, p)`` that realises a controller exactly, ``F_l(J_K, Q) = K``, of the orders of J_K and K together.

    ``J_K`` maps ``[y, alpha]`` to ``[u, beta]``. Q is K seen through J_K solved for ``(alpha, y)``; its poles are those of the loop of K
    with the *nominal* plant, so Q is stable exactly when K holds the healthy machine (Tay, Mareels and Moore, theorem 2.5.1).

    >>> from afdsvc.testing.machines import bearing_problem
    >>> J = bearing_problem("proportional").interconnection
    >>> youla_parameter(J, StateSpace.gain([[0.3, 0.0], [0.0, 0.3]], J.dt)).is_stable()
    True
    """
    m, p = K.outputs, K.inputs
    solved = J_K.inverse().select([*range(p, p + m), *range(p)], [*range(m, m + p), *range(m)])  # (beta, u) -> (alpha, y)
    return star(solved, K, p, m)


def retuned_interconnection(J_K: StateSpace, Q: StateSpace, gain: float = 1.0) -> StateSpace:
    """Return J_K with Q in place, ``[y, alpha] -> [u, beta]``: the excitation adds to ``gain * Q beta``, beta stays the residual.

    It is the J_K form of K(Q) with the same ``Nt`` and ``Mt``: a healthy machine keeps S = 0, and what whitens beta still does.

    >>> from afdsvc.testing.machines import bearing_problem
    >>> J = bearing_problem().interconnection
    >>> retuned_interconnection(J, StateSpace.gain(np.zeros((2, 2)), J.dt)).order == J.order
    True
    """
    m, p = Q.outputs, Q.inputs
    beside = StateSpace(
        Q.A,
        np.hstack([Q.B, np.zeros((Q.order, m))]),
        np.vstack([gain * Q.C, np.zeros((p, Q.order))]),
        np.block([[gain * Q.D, np.eye(m)], [np.eye(p), np.zeros((p, m))]]),
        J_K.dt,
    )
    return star(J_K, beside, p, m)


def plant_from(fact: Factorisation, S: StateSpace) -> StateSpace:
    """Return ``G(S) = (N + V S)(M + U S)^-1 = F_u(J_G, S)`` for a stable S of shape ``(p, m)`` (thesis 2.12).

    The order is that of S plus that of R; `afdsvc.lti.reduce.balanced_truncation` takes out what cancels.
    """
    _shape("S", S, fact.plant.outputs, fact.plant.inputs)
    require_stable(S.A, S.dt, "S", "only a stable S belongs to a plant the controller stabilises")
    m, p = fact.plant.inputs, fact.plant.outputs
    return star(S, plant_interconnection(fact), p, m)


def deviation_system(fact: Factorisation, true_plant: StateSpace) -> StateSpace:
    """Return S from alpha to beta, ``S = Mt (Gt - G)(I - K Gt)^-1 Vt^-1 = F_u(J_K, Gt)``, by closing the loop.

    It is zero when the true plant equals the nominal one, and unstable when the controller does not stabilise the true
    plant. Its order is that of the true plant plus that of J_K.
    """
    _shape("the true plant", true_plant, fact.plant.outputs, fact.plant.inputs)
    return star(true_plant, interconnection(fact), true_plant.outputs, true_plant.inputs)


def residual_generator(fact: Factorisation) -> StateSpace:
    """Return ``[-Nt, Mt]`` from ``[u, y]`` to ``eps = Mt y - Nt u``: the residual without access inside the controller.

    With noise d on the output, ``eps = S (alpha + Ut r1 + Vt r2) + (Mt + S Ut) d``.
    """
    m = fact.plant.inputs
    return trim(fact.Lf.select(slice(m, None), slice(None)))


def reference_compensation(fact: Factorisation) -> StateSpace:
    """Return ``[Mt, Nt]`` from ``[r1, r2]``: subtract its output from beta when references excite instead of alpha.

    ``r1`` is added to the measurement the controller sees, ``r2`` to the input of the plant; what remains is
    ``S (Ut r1 + Vt r2) + (Mt + S Ut) d``.
    """
    m = fact.plant.inputs
    lower = fact.Lf.select(slice(m, None), slice(None))
    signs = np.concatenate([-np.ones(m), np.ones(fact.plant.outputs)])
    flipped = StateSpace(lower.A, lower.B * signs, lower.C, lower.D * signs, lower.dt)
    return trim(flipped.select(slice(None), [*range(m, m + fact.plant.outputs), *range(m)]))


def excited_controller(fact: Factorisation, through: str) -> StateSpace:
    """Return the controller with excitation input and residual output, ``[y, e] -> [u, beta]``, e entering where ``through`` says.

    ``"alpha"``: J_K. ``"input"``: e is added to the controller's output, ``u = K y + e`` (r2 of the thesis). ``"setpoint"``: e is
    subtracted from what the controller sees, ``u = K (y - e)`` (-r1). Always ``beta = Mt y - Nt u``, which excitation alone does not
    move; with references it shows ``S Vt e`` or ``-S Ut e`` instead of ``S alpha``. Raises `BadInput` for another word.

    >>> from afdsvc.lti.coprime import proportional_factorisation
    >>> fact = proportional_factorisation(StateSpace.of([[0.9]], [[1.0]], [[1.0]], [[0.0]], 0.1), np.array([[-0.5]]), np.array([[-0.4]]))
    >>> excited_controller(fact, "input").D.round(3).tolist()
    [[-0.5, 1.0], [1.0, 0.0]]
    """
    if through == "alpha":
        return interconnection(fact)
    K, L, m, p = fact.K, residual_generator(fact), fact.plant.inputs, fact.plant.outputs
    if through not in ("input", "setpoint"):
        raise BadInput(f"excitation through '{through}'; expected alpha, input or setpoint")
    seen, added = (np.zeros((p, m)), np.eye(m)) if through == "input" else (-np.eye(p), np.zeros((m, p)))
    u = np.hstack([K.D, K.D @ seen + added])  # of [y, e]
    u_and_y = np.vstack([u, np.hstack([np.eye(p), np.zeros((p, seen.shape[1]))])])
    A = np.block([[K.A, np.zeros((K.order, L.order))], [L.B[:, :m] @ K.C, L.A]])
    C = np.block([[K.C, np.zeros((m, L.order))], [L.D[:, :m] @ K.C, L.C]])
    return StateSpace(A, np.vstack([K.B @ np.hstack([np.eye(p), seen]), L.B @ u_and_y]), C, np.vstack([u, L.D @ u_and_y]), K.dt)


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoop:
    """A closed loop with named signals: inputs ``d, r1, r2, alpha``, outputs ``y, y_m, u, beta``.

    ``y`` is the plant's output without noise, ``y_m = y + d``, the controller sees ``y_m + r1``, the plant's input is
    ``u = u_K + r2``.
    """

    system: StateSpace
    outputs: int
    inputs: int

    def path(self, output: str, input: str) -> StateSpace:
        """Return the system from one named input to one named output; raises `BadInput` for an unknown name."""
        p, m = self.outputs, self.inputs
        rows = _signal(output, {"y": p, "y_m": p, "u": m, "beta": p}, "output")
        columns = _signal(input, {"d": p, "r1": p, "r2": m, "alpha": m}, "input")
        return trim(self.system.select(rows, columns))


def closed_loop(fact: Factorisation, true_plant: StateSpace) -> ClosedLoop:
    """Return the loop of a true plant with J_K; every path is read off by name.

    With S the deviation of the true plant: ``beta = S alpha + (Mt + S Ut)(d + r1) + (Nt + S Vt) r2``,
    ``y = (N + V S)(alpha + Ut (d + r1) + Vt r2)``, ``u = (M + U S)(alpha + Ut (d + r1) + Vt r2)``.
    """
    p, m = true_plant.outputs, true_plant.inputs
    _shape("the true plant", true_plant, fact.plant.outputs, fact.plant.inputs)
    loop = star(_with_disturbances(true_plant), interconnection(fact), p, m)
    # outputs of the star: y, y_m, u, beta; inputs: d, r1, r2, alpha
    return ClosedLoop(loop, p, m)


def _with_disturbances(plant: StateSpace) -> StateSpace:
    """Return the plant with inputs (d, r1, r2, u_K) and outputs (y, y_m, u, y_m + r1)."""
    p, m, n = plant.outputs, plant.inputs, plant.order
    Op, Omp, Ip, Im = np.zeros((p, p)), np.zeros((m, p)), np.eye(p), np.eye(m)
    B = np.hstack([np.zeros((n, 2 * p)), plant.B, plant.B])
    C = np.vstack([plant.C, plant.C, np.zeros((m, n)), plant.C])
    D = np.block(
        [
            [Op, Op, plant.D, plant.D],
            [Ip, Op, plant.D, plant.D],
            [Omp, Omp, Im, Im],
            [Ip, Ip, plant.D, plant.D],
        ]
    )
    return StateSpace(plant.A, B, C, D, plant.dt)


def _signal(name: str, widths: dict[str, int], kind: str) -> slice:
    if name not in widths:
        raise BadInput(f"the closed loop has no {kind} '{name}'; it has {', '.join(widths)}")
    names = list(widths)
    start = sum(widths[k] for k in names[: names.index(name)])
    return slice(start, start + widths[name])


def _shape(name: str, system: StateSpace, outputs: int, inputs: int) -> None:
    if system.D.shape != (outputs, inputs):
        raise BadInput(f"{name} has {system.outputs} outputs and {system.inputs} inputs; expected {outputs} and {inputs}")
