"""Loss of accuracy of the factorisation identities by rounding, in numbers independent of units."""

from __future__ import annotations

import numpy as np

from afdsvc.errors import IllConditioned
from afdsvc.lti.frequency import transfer
from afdsvc.lti.scaling import balanced, state_scaling
from afdsvc.lti.stability import eigenvalues
from afdsvc.lti.statespace import Array, ComplexArray, StateSpace

LIMIT = 1e-10  # of the identity at the poles' frequencies; whatever is derived from the factors then holds to 1e-9


def require_identity(R: StateSpace, Lf: StateSpace) -> None:
    """Raise `IllConditioned` with both numbers unless ``R Lf = Lf R = I`` holds to 1e-10."""
    residual = identity_residual(R, Lf)
    if residual <= LIMIT:
        return
    raise IllConditioned(
        f"the double Bezout identity holds only to {residual:.1e} (expected below {LIMIT:.0e}): rounding "
        f"is amplified {amplification(R, Lf):.1e} times; choose gains that move the poles less, or reduce the model"
    )


def identity_residual(R: StateSpace, Lf: StateSpace) -> float:
    """Return the largest entry of ``R Lf - I`` and ``Lf R - I`` near the frequencies of all poles, in fair units.

    Fair are the units of u and y (the same for alpha and beta) in which ``|R| |Lf|`` has entries of like size.
    """
    points = _points(R, Lf)
    right, left = transfer(R, points), transfer(Lf, points)
    eye = np.eye(R.inputs)
    return max(_in_fair_units(np.abs(a @ b - eye), np.abs(a) @ np.abs(b)) for a, b in ((right, left), (left, right)))


def amplification(R: StateSpace, Lf: StateSpace) -> float:
    """Return how many times relative rounding of the state-space matrices can show in ``R Lf - I`` and ``Lf R - I``.

    To first order a change E of A moves a transfer matrix by ``C F E F B`` with ``F = (sI - A)^-1``; E is taken as
    large as rounding makes it (relative to the norm of balanced A and to the products it was summed from).
    Multiplied by 1.1e-16 this bounds the residual of the identities, which is typically a hundredth of it.
    """
    points = _points(R, Lf)
    (right, right_error), (left, left_error) = _response(R, points), _response(Lf, points)
    first, second = right @ left_error + right_error @ left, left @ right_error + left_error @ right
    return max(_in_fair_units(bound, bound) for bound in (first, second))


def _in_fair_units(entries: Array, sizes: Array) -> float:
    """Return the largest entry after the diagonal similarity scaling that balances ``sizes``; both ``(k, q, q)``."""
    t = state_scaling(sizes.max(axis=0))
    return float((entries * t[None, None, :] / t[None, :, None]).max(initial=0.0))


def _points(R: StateSpace, Lf: StateSpace) -> ComplexArray:
    """Return points on the border of stability near every pole of both systems, and both ends."""
    poles = np.concatenate([eigenvalues(R.A), eigenvalues(Lf.A)])
    if R.discrete:
        distance = np.minimum(-np.log(np.maximum(np.abs(poles), 1e-3)), np.pi)
        angles = np.concatenate([np.abs(np.angle(poles)), distance, [0.0, np.pi]])
        return np.asarray(np.exp(1j * np.unique(np.round(angles, 6))), dtype=np.complex128)
    size = np.concatenate([np.abs(poles.imag), np.abs(poles), [0.0]])
    return np.asarray(1j * np.unique(np.concatenate([size, [10 * size.max()]])), dtype=np.complex128)


def _response(system: StateSpace, points: ComplexArray) -> tuple[Array, Array]:
    """Return |G| and the effect on it of relative rounding in the matrices, each of shape ``(k, p, m)``."""
    s, _ = balanced(system)
    eye = np.eye(s.order)
    resolvent = np.linalg.inv(points[:, None, None] * eye - s.A)
    to_output, from_input = np.abs(s.C @ resolvent), np.abs(resolvent @ s.B)
    size = np.linalg.norm(s.A, 2) if s.order else 0.0
    entries = size + np.abs(s.B) @ np.abs(s.C) + np.abs(points)[:, None, None] * eye
    error = to_output @ entries @ from_input + np.abs(s.C) @ from_input + to_output @ np.abs(s.B) + np.abs(s.D)
    return np.abs(s.C @ resolvent @ s.B + s.D), error
