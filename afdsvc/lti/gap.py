"""The distance between two plants as feedback sees it (nu-gap), and how much of it a controller tolerates.

``nu_gap(G1, G2)`` is between 0 and 1. A controller K with ``stability_margin(G1, K)`` above it stabilises G2 as well. Both depend on the
units of inputs and outputs: scale the plants first, so that 1 is a large signal everywhere.

Source: G. Vinnicombe, "Uncertainty and Feedback: H-infinity Loop-shaping and the nu-gap Metric", Imperial College Press, 2001, chapters 2
and 3. Positive feedback ``u = K y`` throughout.
"""

from __future__ import annotations

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.frequency import transfer
from afdsvc.lti.lft import star
from afdsvc.lti.norms import largest_gain
from afdsvc.lti.riccati import riccati
from afdsvc.lti.statespace import Array, ComplexArray, StateSpace

STEP = 0.3  # rad; the phase of the determinant is followed in steps no larger
HALVINGS = 30


def graph(plant: StateSpace) -> StateSpace:
    """Return the normalised right coprime factors ``[N; M]``, shape ``(p + m, m)``: ``G = N M^-1``, ``N~ N + M~ M = I``, discrete time."""
    A, B, C, D, m = plant.A, plant.B, plant.C, plant.D, plant.inputs
    if not plant.discrete:
        raise BadInput("a continuous plant; expected a discrete one (sample it with afdsvc.lti.sampling.sample_zoh)")
    X, F = riccati(A, B, C.T @ C, np.eye(m) + D.T @ D, C.T @ D, plant.dt)
    values, vectors = np.linalg.eigh(np.eye(m) + D.T @ D + B.T @ X @ B)
    W = (vectors / np.sqrt(values)) @ vectors.T
    return StateSpace.of(A + B @ F, B @ W, np.vstack([C + D @ F, F]), np.vstack([D, np.eye(m)]) @ W, plant.dt)


def nu_gap(one: StateSpace, other: StateSpace) -> float:
    """Return the nu-gap of two discrete plants of the same shape; 1 where no controller could take one for the other.

    Raises `IllConditioned` for a plant with a mode on the unit circle that is not reached or not seen.

    >>> G = StateSpace.of([[0.5]], [[1.0]], [[1.0]], [[0.0]], 1.0)
    >>> nu_gap(G, G) < 1e-12, round(nu_gap(StateSpace.gain([[1.0]], 1.0), StateSpace.gain([[0.0]], 1.0)), 4)
    (True, 0.7072)
    """
    p, m = one.outputs, one.inputs
    if (other.outputs, other.inputs) != (p, m):
        raise BadInput(f"plants of {p} x {m} and {other.outputs} x {other.inputs} outputs x inputs; expected the same shape")
    first, second = graph(one), graph(other)
    if not _same_winding(first, second):
        return 1.0
    left = _transposed(graph(_transposed(other)))  # [Nt Mt] with G = Mt^-1 Nt
    crossed = np.block([[np.zeros((m, p)), np.eye(m)], [-np.eye(p), np.zeros((p, m))]])
    return min(1.0, largest_gain(left @ StateSpace.gain(crossed, one.dt) @ first))


def stability_margin(plant: StateSpace, controller: StateSpace) -> float:
    """Return b(G, K), between 0 and 1: K stabilises every plant whose nu-gap to G is smaller; raises `BadInput` for an unstable loop."""
    G, p, m = plant, plant.outputs, plant.inputs
    B = np.hstack([np.zeros((G.order, p)), G.B, G.B])
    D = np.block([[np.eye(p), G.D, G.D], [np.zeros((m, p + m)), np.eye(m)], [np.eye(p), G.D, G.D]])
    open_loop = StateSpace(G.A, B, np.vstack([G.C, np.zeros((m, G.order)), G.C]), D, G.dt)
    return 1.0 / largest_gain(star(open_loop, controller, p, m))


def _transposed(system: StateSpace) -> StateSpace:
    return StateSpace(system.A.T, system.C.T, system.B.T, system.D.T, system.dt)


def _same_winding(first: StateSpace, second: StateSpace) -> bool:
    """Return whether ``det(G2~ G1)`` of the graphs is never zero on the unit circle and does not wind around zero."""

    def determinant(angles: Array) -> ComplexArray:
        z = np.exp(1j * angles)
        a, b = transfer(first, z), transfer(second, z)
        return np.asarray(np.linalg.det(np.conj(np.swapaxes(b, 1, 2)) @ a), dtype=np.complex128)

    poles = np.concatenate([first.poles(), second.poles()])
    angles = np.unique(np.concatenate([np.geomspace(1e-6, np.pi, 400), np.abs(np.angle(poles)), [0.0]]))
    values = determinant(angles)
    for _ in range(HALVINGS):
        wide = np.flatnonzero(np.abs(np.angle(values[1:] / values[:-1])) > STEP)
        if not wide.size:
            break
        new = (angles[wide] + angles[wide + 1]) / 2
        angles, order = np.unique(np.concatenate([angles, new]), return_index=True)
        values = np.concatenate([values, determinant(new)])[order]
    return bool(np.abs(values).min() > 1e-9 and abs(np.angle(values[1:] / values[:-1]).sum()) < 1.0)
