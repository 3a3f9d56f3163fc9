"""Model reduction by balanced truncation, in continuous and discrete time alike (square-root algorithm).

Unstable modes are kept; only the stable part is reduced. python-control's ``balred`` returns a discrete model
unreduced; this one does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import schur, solve_continuous_lyapunov, solve_discrete_lyapunov, solve_sylvester

from afdsvc.errors import BadInput, IllConditioned
from afdsvc.lti.scaling import balanced
from afdsvc.lti.stability import require_stable
from afdsvc.lti.statespace import Array, StateSpace, block_diagonal


@dataclass(frozen=True, slots=True, eq=False)
class Reduction:
    """A reduced system, the Hankel singular values of its stable part (all of them, falling), and the error bound.

    ``bound`` is twice the sum of what was left out: no frequency has a larger error (not for weighted reductions, where
    it is nan).
    """

    system: StateSpace
    hankel: Array
    bound: float


def balanced_truncation(system: StateSpace, order: int | None = None, tolerance: float = 1e-10) -> Reduction:
    """Return the system with ``order`` states, or with every Hankel singular value above ``tolerance`` of the largest.

    Raises `BadInput` when the order is below the number of unstable modes or above the system's order.
    """
    stable, unstable = split_stable(system)
    factors = _gramian_factors(stable)
    return _truncate(stable, unstable, factors, order, tolerance, weighted=False)


def hankel_singular_values(system: StateSpace) -> Array:
    """Return the Hankel singular values of a stable system, falling, shape ``(n,)``."""
    require_stable(system.A, system.dt, "the system", "Hankel singular values exist for stable systems only")
    Lc, Lo = _gramian_factors(balanced(system)[0])
    return np.asarray(np.linalg.svd(Lo.T @ Lc, compute_uv=False), dtype=np.float64)


def weighted_truncation(
    system: StateSpace, order: int, output_weight: StateSpace | None = None, input_weight: StateSpace | None = None
) -> Reduction:
    """Return the system reduced so that ``Wo (G - Gr) Wi`` is small (Enns' frequency-weighted balanced truncation).

    The weights must be stable; left out they are the identity.
    """
    stable, unstable = split_stable(system)
    for name, weight in (("the output weight", output_weight), ("the input weight", input_weight)):
        if weight is not None:
            require_stable(weight.A, weight.dt, name, "weights must be stable")
    n = stable.order
    Lc = _gramian_factors(stable if input_weight is None else stable @ input_weight)[0]
    Lo = _gramian_factors(stable if output_weight is None else output_weight @ stable)[1]
    # in a series the states of the first system come first
    Lc = Lc if input_weight is None else Lc[input_weight.order :]
    Lo = Lo if output_weight is None else Lo[:n]
    return _truncate(stable, unstable, (Lc, Lo), order, 0.0, weighted=True)


def closed_loop_truncation(plant: StateSpace, controller: StateSpace, order: int) -> Reduction:
    """Return the plant reduced where the loop looks: weights ``(I - G K)^-1`` at its output, ``(I - K G)^-1`` at its
    input.

    To first order the change of the closed loop from r2 to y is ``(I - G K)^-1 (Gr - G) (I - K G)^-1``.
    """
    from afdsvc.lti.coprime import controller_factorisation, stable_controller_factorisation
    from afdsvc.lti.stability import is_stable

    stable = is_stable(controller.A, controller.dt)
    fact = (stable_controller_factorisation if stable else controller_factorisation)(plant, controller)
    output = fact.Mt if stable else fact.V @ fact.Mt
    input_ = fact.M if stable else fact.M @ fact.Vt
    return weighted_truncation(plant, order, output, input_)


def split_stable(system: StateSpace) -> tuple[StateSpace, StateSpace]:
    """Return the stable part and the rest (feedthrough in the stable part), which add up to the system."""
    scaled, _ = balanced(system)
    inside = (lambda re, im: re * re + im * im < 1) if system.discrete else (lambda re, im: re < 0)
    if not system.order:
        return scaled, StateSpace.gain(np.zeros_like(system.D), system.dt)
    T, Z, k = schur(scaled.A, output="real", sort=inside)
    if k == system.order:
        return scaled, StateSpace.gain(np.zeros_like(system.D), system.dt)
    X = solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:])
    B, C = Z.T @ scaled.B, scaled.C @ Z
    stable = StateSpace(T[:k, :k], B[:k] - X @ B[k:], C[:, :k], scaled.D, system.dt)
    rest = StateSpace(T[k:, k:], B[k:], C[:, :k] @ X + C[:, k:], np.zeros_like(system.D), system.dt)
    return stable, rest


def _gramian_factors(system: StateSpace) -> tuple[Array, Array]:
    """Return factors of the controllability and observability Gramians, ``P = Lc Lc'`` and ``Q = Lo Lo'``."""
    if not system.order:
        return np.zeros((0, 0)), np.zeros((0, 0))
    solve = solve_discrete_lyapunov if system.discrete else _continuous_gramian
    P, Q = solve(system.A, system.B @ system.B.T), solve(system.A.T, system.C.T @ system.C)
    return _root(np.asarray(P, dtype=np.float64)), _root(np.asarray(Q, dtype=np.float64))


def _continuous_gramian(A: Array, Q: Array) -> Array:
    return np.asarray(solve_continuous_lyapunov(A, -Q), dtype=np.float64)


def _root(P: Array) -> Array:
    """Return L with ``L L' = P`` for a symmetric matrix whose negative eigenvalues are rounding."""
    values, vectors = np.linalg.eigh((P + P.T) / 2)
    return np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)), dtype=np.float64)


def _truncate(
    stable: StateSpace,
    unstable: StateSpace,
    factors: tuple[Array, Array],
    order: int | None,
    tolerance: float,
    weighted: bool,
) -> Reduction:
    Lc, Lo = factors
    W, hankel, Vt = np.linalg.svd(Lo.T @ Lc) if stable.order else (np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)))
    k = _kept(hankel, unstable.order, stable.order, order, tolerance)
    if k and not hankel[k - 1] > 1e-15 * hankel[0]:
        raise IllConditioned(
            f"Hankel singular value {k} is {hankel[k - 1]:.2g} against {hankel[0]:.2g}: the system has fewer states "
            f"that "
            f"matter than the {k + unstable.order} asked for; ask for fewer"
        )
    scale = 1 / np.sqrt(hankel[:k])
    left, right = (Lo @ W[:, :k] * scale).T, Lc @ Vt[:k].T * scale
    reduced = StateSpace(left @ stable.A @ right, left @ stable.B, stable.C @ right, stable.D, stable.dt)
    both = block_diagonal(reduced, unstable)
    system = StateSpace(both.A, np.vstack([reduced.B, unstable.B]), np.hstack([reduced.C, unstable.C]), stable.D, stable.dt)
    return Reduction(system, hankel, float("nan") if weighted else 2 * float(hankel[k:].sum()))


def _kept(hankel: Array, unstable: int, stable: int, order: int | None, tolerance: float) -> int:
    """Return how many stable states to keep."""
    if order is None:
        return int((hankel > tolerance * hankel[0]).sum()) if hankel.size else 0
    if not unstable <= order <= stable + unstable:
        raise BadInput(f"order {order} is not possible; from {unstable} (the unstable modes) to {stable + unstable} is")
    return order - unstable
