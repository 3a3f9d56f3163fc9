"""Coprime factors of a plant and the controller that stabilises it, in state space.

Positive feedback ``u = K y``. One square system holds all eight factors,

    R  = [M U; N V]        : (alpha, beta) -> (u, y)
    Lf = [Vt -Ut; -Nt Mt]  : (u, y) -> (alpha, beta),     R Lf = Lf R = I   (double Bezout identity)

with ``G = N M^-1 = Mt^-1 Nt`` and ``K = U V^-1 = Vt^-1 Ut``. Everything holds unchanged in continuous and discrete time
and with feedthrough D in the plant. Every function refuses with `IllConditioned` when rounding breaks the Bezout
identity beyond 1e-10 (`afdsvc.lti.conditioning`).

Thesis 2.5-2.9, 2.21-2.35: A. K. Sekunda, "Fault Diagnosis and Identification of Electro-Mechanical Systems", DTU 2017;
the sign of 2.28-2.33 is corrected here, see docs/explanation/errata.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from afdsvc.errors import BadInput, IllConditioned
from afdsvc.lti.conditioning import require_identity
from afdsvc.lti.lft import star
from afdsvc.lti.stabilise import invariant_half
from afdsvc.lti.stability import require_stabilising, require_stable, trim
from afdsvc.lti.statespace import Array, StateSpace, common_dt, solve_loop

OBSERVER_LIMIT = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class Factorisation:
    """Coprime factors of ``plant`` and ``controller``: all eight are stable and satisfy the double Bezout identity.

    The first ``plant.order`` states of ``R`` are a copy of the plant's states driven by alpha.
    """

    plant: StateSpace
    controller: StateSpace
    R: StateSpace
    Lf: StateSpace

    @property
    def K(self) -> StateSpace:
        """The controller from y to u."""
        return self.controller

    @property
    def M(self) -> StateSpace:
        """Right denominator of the plant, ``G = N M^-1``; shape ``(m, m)``."""
        return self._right(0, 0)

    @property
    def N(self) -> StateSpace:
        """Right numerator of the plant; shape ``(p, m)``."""
        return self._right(1, 0)

    @property
    def U(self) -> StateSpace:
        """Right numerator of the controller, ``K = U V^-1``; shape ``(m, p)``."""
        return self._right(0, 1)

    @property
    def V(self) -> StateSpace:
        """Right denominator of the controller; shape ``(p, p)``."""
        return self._right(1, 1)

    @property
    def Vt(self) -> StateSpace:
        """Left denominator of the controller, ``K = Vt^-1 Ut``; shape ``(m, m)``."""
        return self._left(0, 0)

    @property
    def Ut(self) -> StateSpace:
        """Left numerator of the controller; shape ``(m, p)``."""
        return -self._left(0, 1)

    @property
    def Nt(self) -> StateSpace:
        """Left numerator of the plant, ``G = Mt^-1 Nt``; shape ``(p, m)``."""
        return -self._left(1, 0)

    @property
    def Mt(self) -> StateSpace:
        """Left denominator of the plant; shape ``(p, p)``."""
        return self._left(1, 1)

    def _right(self, row: int, column: int) -> StateSpace:
        return self._block(self.R, row, column)

    def _left(self, row: int, column: int) -> StateSpace:
        return self._block(self.Lf, row, column)

    def _block(self, system: StateSpace, row: int, column: int) -> StateSpace:
        m = self.plant.inputs
        halves = (slice(None, m), slice(m, None))
        return trim(system.select(halves[row], halves[column]))


def observer_factorisation(plant: StateSpace, F: ArrayLike, L: ArrayLike) -> Factorisation:
    """Return the factors belonging to a full-order observer with state feedback (thesis 2.26, 2.27, any D).

    ``x^+ = A x^ + B u + L (C x^ + D u - y)``, ``u = F x^ + alpha``, ``beta = y - C x^ - D u`` (the innovation); shapes
    ``F (m, n)``, ``L (n, p)``. Raises `BadInput` with the pole when A + B F or A + L C is not stable.
    """
    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    F, L = _gain("F", F, (plant.inputs, plant.order)), _gain("L", L, (plant.order, plant.outputs))
    require_stable(A + B @ F, plant.dt, "A + B F", "choose another state feedback F")
    require_stable(A + L @ C, plant.dt, "A + L C", "choose another observer gain L")
    controller = StateSpace(A + B @ F + L @ (C + D @ F), -L, F, np.zeros((plant.inputs, plant.outputs)), plant.dt)
    m, p = plant.inputs, plant.outputs
    R = StateSpace(
        A + B @ F,
        np.hstack([B, -L]),
        np.vstack([F, C + D @ F]),
        np.block([[np.eye(m), np.zeros((m, p))], [D, np.eye(p)]]),
        plant.dt,
    )
    Lf = StateSpace(
        A + L @ C,
        np.hstack([-(B + L @ D), L]),
        np.vstack([F, C]),
        np.block([[np.eye(m), np.zeros((m, p))], [-D, np.eye(p)]]),
        plant.dt,
    )
    return _checked(plant, controller, R, Lf)


def proportional_factorisation(plant: StateSpace, P: ArrayLike, F: ArrayLike | None = None) -> Factorisation:
    """Return the factors belonging to the static controller ``u = P y`` (thesis 2.23, 2.24, any D).

    ``F (m, n)`` is any gain with A + B F stable; without it ``F = (I - P D)^-1 P C``, which is stable because P
    stabilises the plant, and gives ``V = I``, ``Vt = (I - P D)^-1`` and ``M = (I - P G)^-1 (I - P D)``. Raises
    `NotStabilising` or `BadInput`.
    """
    P = _static("P", P, plant.inputs, plant.outputs)
    controller = StateSpace.gain(P, plant.dt)
    require_stabilising(plant, controller)
    if F is None:
        F = solve_loop(np.eye(plant.inputs) - P @ plant.D) @ P @ plant.C
    return _general(plant, controller, _gain("F", F, (plant.inputs, plant.order)), np.zeros((plant.outputs, 0)))


def controller_factorisation(
    plant: StateSpace, K: StateSpace, F: ArrayLike | None = None, Fk: ArrayLike | None = None
) -> Factorisation:
    """Return the factors for any stabilising linear controller, of any order, stable or not; R has order n + n_K.

    ``F (m, n)`` makes A + B F stable, ``Fk (p, n_K)`` makes Ak + Bk Fk stable; those left out are the cheapest gains
    that give their system at least half the stability margin of the closed loop (zero when it already has it). Raises
    `NotStabilising` with the closed-loop pole, `BadInput` for shapes.
    """
    from afdsvc.lti.stabilise import gain_with_margin, half_margin

    require_stabilising(plant, K)
    margin = half_margin(plant, K)
    dt = common_dt(plant, K)
    F = gain_with_margin(plant.A, plant.B, dt, margin) if F is None else _gain("F", F, (plant.inputs, plant.order))
    Fk = gain_with_margin(K.A, K.B, dt, margin) if Fk is None else _gain("Fk", Fk, (K.inputs, K.order))
    return _general(plant, K, F, Fk)


def observer_form(plant: StateSpace, K: StateSpace) -> Factorisation:
    """Return the factors of a controller of the plant's order read as an observer with a static Youla term; R has
    order n.

    ``u = F x^ + Q (y - C x^ - D u) + alpha``, ``beta = y - C x^ - D u``, with Q the controller's feedthrough. Raises
    `IllConditioned` with the condition number when no half of the closed-loop poles gives a usable observer (then
    `controller_factorisation` does), `BadInput` when the orders differ, `NotStabilising`.
    """
    require_stabilising(plant, K)
    if K.order != plant.order:
        raise BadInput(f"the controller has order {K.order}; expected the plant's order {plant.order} for an observer")
    dt, p = common_dt(plant, K), plant.outputs
    proper = star(_subtract_feedthrough(plant, dt), K, p, plant.inputs)  # y - D u -> u
    strict = StateSpace(plant.A, plant.B, plant.C, np.zeros_like(plant.D), dt)
    T, condition = invariant_half(star(strict, proper, p, plant.inputs).A, plant.order)
    if not condition < OBSERVER_LIMIT:
        raise IllConditioned(
            f"the controller has no well-conditioned observer form (condition number {condition:.2g}, expected below "
            f"{OBSERVER_LIMIT:.0g}); use controller_factorisation, of order n + n_K"
        )
    Q = proper.D
    F, L = Q @ plant.C + proper.C @ T, plant.B @ Q - np.linalg.solve(T, proper.B)
    return _observer_with_youla(plant, K, F, L, Q)


def _subtract_feedthrough(plant: StateSpace, dt: float) -> StateSpace:
    """Return the static map (y', u) -> (u, y) with ``y = y' + D u``: a controller behind it sees y' = y - D u."""
    p, m = plant.outputs, plant.inputs
    return StateSpace.gain(np.block([[np.zeros((m, p)), np.eye(m)], [np.eye(p), plant.D]]), dt)


def _observer_with_youla(plant: StateSpace, K: StateSpace, F: Array, L: Array, Q: Array) -> Factorisation:
    """Return the observer's factors with U, V replaced by U + M Q, V + N Q."""
    base = observer_factorisation(plant, F, L)
    m, p = plant.inputs, plant.outputs
    youla = StateSpace.gain(np.block([[np.eye(m), Q], [np.zeros((p, m)), np.eye(p)]]), base.R.dt)
    back = StateSpace.gain(np.block([[np.eye(m), -Q], [np.zeros((p, m)), np.eye(p)]]), base.R.dt)
    return _checked(plant, K, base.R @ youla, back @ base.Lf)


def _general(plant: StateSpace, K: StateSpace, F: Array, Fk: Array) -> Factorisation:
    dt = common_dt(plant, K)
    require_stable(plant.A + plant.B @ F, dt, "A + B F", "choose another state feedback F")
    require_stable(K.A + K.B @ Fk, dt, "Ak + Bk Fk", "choose another gain Fk")
    n, nk = plant.order, K.order
    A = np.block([[plant.A + plant.B @ F, np.zeros((n, nk))], [np.zeros((nk, n)), K.A + K.B @ Fk]])
    B = np.block([[plant.B, np.zeros((n, plant.outputs))], [np.zeros((nk, plant.inputs)), K.B]])
    C = np.block([[F, K.C + K.D @ Fk], [plant.C + plant.D @ F, Fk]])
    R = StateSpace(A, B, C, np.block([[np.eye(plant.inputs), K.D], [plant.D, np.eye(plant.outputs)]]), dt)
    return _checked(plant, K, R, _general_left(plant, K, F, Fk, dt))


def _general_left(plant: StateSpace, K: StateSpace, F: Array, Fk: Array, dt: float) -> StateSpace:
    """Return R^-1, (u, y) -> (alpha, beta), written from the plant and K: its state matrix is the closed loop's.

    ``e = y - C x - D v``, ``v = u - Ck xk - Dk e``, ``x+ = A x + B v``, ``xk+ = Ak xk + Bk e``, ``alpha = v - F x``,
    ``beta = e - Fk xk``.
    """
    n, nk, m, p = plant.order, K.order, plant.inputs, plant.outputs
    E = solve_loop(np.eye(p) - plant.D @ K.D)
    e = E @ np.hstack([-plant.C, plant.D @ K.C, -plant.D, np.eye(p)])  # of (x, xk, u, y)
    v = np.hstack([np.zeros((m, n)), -K.C, np.eye(m), np.zeros((m, p))]) - K.D @ e
    x = np.hstack([plant.A, np.zeros((n, nk + m + p))]) + plant.B @ v
    xk = np.hstack([np.zeros((nk, n)), K.A, np.zeros((nk, m + p))]) + K.B @ e
    alpha = v - np.hstack([F, np.zeros((m, nk + m + p))])
    beta = e - np.hstack([np.zeros((p, n)), Fk, np.zeros((p, m + p))])
    after, out = np.vstack([x, xk]), np.vstack([alpha, beta])
    return StateSpace(after[:, : n + nk], after[:, n + nk :], out[:, : n + nk], out[:, n + nk :], dt)


def stable_controller_factorisation(plant: StateSpace, K: StateSpace) -> Factorisation:
    """Return the factors of a stable controller known only by its transfer functions (thesis 2.28-2.35, sign
    corrected).

    ``M = (I - K G)^-1``, ``N = G M``, ``V = Vt = I``, ``U = Ut = K``, ``Mt = (I - G K)^-1``, ``Nt = Mt G``: no gains
    are needed, ``u = K y + alpha`` and ``beta = y - N alpha``. R has order n + 2 n_K. Raises `NotStabilising`, or
    `BadInput` with the pole when K is not stable.
    """
    require_stabilising(plant, K)
    dt = common_dt(plant, K)
    require_stable(K.A, dt, "the controller", "use controller_factorisation, which takes unstable controllers")
    closed = star(_with_excitation(plant), K, plant.outputs, plant.inputs)  # alpha -> (u, y)
    n = closed.order
    A = np.block([[closed.A, np.zeros((n, K.order))], [np.zeros((K.order, n)), K.A]])
    B = np.block([[closed.B, np.zeros((n, K.inputs))], [np.zeros((K.order, plant.inputs)), K.B]])
    C = np.hstack([closed.C, np.vstack([K.C, np.zeros((plant.outputs, K.order))])])
    D = np.hstack([closed.D, np.vstack([K.D, np.eye(plant.outputs)])])
    R = StateSpace(A, B, C, D, dt)
    return _checked(plant, K, R, _left_of_stable(plant, K, dt))


def _left_of_stable(plant: StateSpace, K: StateSpace, dt: float) -> StateSpace:
    """Return ``[I -K; -(I-GK)^-1 G  (I-GK)^-1]`` from (u, y), with the loop closed in state space."""
    E = solve_loop(np.eye(plant.outputs) - plant.D @ K.D)
    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    # e = y + G(K e - u):  the plant copy sees v = K e - u
    e = np.hstack([E @ C, E @ D @ K.C, -E @ D, E])  # of (x, xk, u, y)
    v = K.D @ e + np.hstack(
        [np.zeros((plant.inputs, plant.order)), K.C, -np.eye(plant.inputs), np.zeros((plant.inputs, plant.outputs))]
    )
    n, nk, m, p = plant.order, K.order, plant.inputs, plant.outputs
    top = np.hstack([A, np.zeros((n, nk + m + p))]) + B @ v
    middle = np.hstack([np.zeros((nk, n)), K.A, np.zeros((nk, m + p))]) + K.B @ e
    own = np.hstack([np.zeros((nk, n + nk + m)), K.B])
    A_all = np.block([[np.vstack([top, middle])[:, : n + nk], np.zeros((n + nk, nk))], [np.zeros((nk, n + nk)), K.A]])
    B_all = np.vstack([np.vstack([top, middle])[:, n + nk :], own[:, n + nk :]])
    C_all = np.block([[np.zeros((m, n + nk)), -K.C], [e[:, : n + nk], np.zeros((p, nk))]])
    D_all = np.vstack([np.hstack([np.eye(m), -K.D]), e[:, n + nk :]])
    return StateSpace(A_all, B_all, C_all, D_all, dt)


def _with_excitation(plant: StateSpace) -> StateSpace:
    """Return the plant with inputs (alpha, u_K), ``u = u_K + alpha``, and outputs (u, y, y)."""
    m = plant.inputs
    B, eye = np.hstack([plant.B, plant.B]), np.eye(m)
    D = np.vstack([np.hstack([eye, eye]), np.hstack([plant.D, plant.D]), np.hstack([plant.D, plant.D])])
    return StateSpace(plant.A, B, np.vstack([np.zeros((m, plant.order)), plant.C, plant.C]), D, plant.dt)


def _checked(plant: StateSpace, K: StateSpace, R: StateSpace, Lf: StateSpace) -> Factorisation:
    require_identity(R, Lf)
    return Factorisation(plant, K, R, Lf)


def _gain(name: str, value: ArrayLike, shape: tuple[int, int]) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise BadInput(f"gain {name} has shape {array.shape}; expected a finite matrix of shape {shape}")
    return array


def _static(name: str, value: ArrayLike, rows: int, columns: int) -> Array:
    """Return a static gain as a matrix; a scalar k means k times the identity."""
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == 0 and rows == columns:
        array = float(array) * np.eye(rows)
    return _gain(name, array, (rows, columns))
