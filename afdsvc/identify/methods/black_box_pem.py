"""Direct prediction-error identification of a black box, from a subspace estimate onwards.

The predictor ``x+ = (A - K C) x + [B - K D, K][u; y]`` is itself a stable system; all systems near it of the same order
are its local coordinates, and the determinant of the errors' covariance is minimised over them (maximum likelihood for
Gaussian noise; Ljung, System Identification, 1999, section 7.4). Plant and noise model move together, so feedback does
no harm when the noise model is rich enough and u answers to y with a delay (D zero).

Local coordinates: of the entries of (A, B, C) only the directions that change the transfer function count; those along a change of state
coordinates, ``(T A - A T, T B, -C T)``, are projected out (data-driven local coordinates; McKelvey, Helmersson and
Ribarits, Automatica 40, 2004). What remains, n (m + p) numbers (and D where it is not zero), is well conditioned around
a balanced realisation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from afdsvc.dataset.arrays import Recording, scaled, scales
from afdsvc.errors import IllConditioned
from afdsvc.identify.numerics.innovations_form import InnovationsForm, fitted_errors
from afdsvc.identify.numerics.prediction_errors import eliminate_state, sweep, whitening_of
from afdsvc.identify.parameters.noise_structure import Slopes
from afdsvc.identify.parameters.structure import Parameter, Structure
from afdsvc.lti.reduce import balanced_truncation
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.stats.levenberg_marquardt import Local, descend

_ROUNDS = 3


def black_box_pem(model: InnovationsForm, recordings: Sequence[Recording]) -> InnovationsForm:
    """Return the innovations form of the same order that predicts the recordings best, near the one handed in."""
    u, y = scales(recordings)
    relative = scaled(recordings, u, y)
    predictor = _balanced(_scaled_predictor(model, u, y))
    for _ in range(_ROUNDS):  # coordinates, and the weight of the errors, belong to where they are
        objective = _Prediction(local_structure(predictor), relative)
        z = np.zeros(len(objective.structure.parameters))
        unbounded = np.full(len(z), np.inf)
        best = descend(objective.local, z, -unbounded, unbounded, steps=20)
        predictor = _balanced(objective.structure.build(best.point * objective.structure.scales))
        if best.steps <= 1:
            break
    return _from_predictor(predictor, u, y, relative)


@dataclass(eq=False)
class _Prediction:
    """Half the sum of the squared prediction errors, weighted with their covariance at the start."""

    structure: Structure
    recordings: Sequence[Recording]

    def __post_init__(self) -> None:
        start = self.structure.build(np.zeros(len(self.structure.parameters)))
        errors = np.vstack([fitted_errors(start, _inputs(r), r.y) for r in self.recordings])
        self.whitener = whitening_of(errors.T @ errors / len(errors) + 1e-24 * np.eye(errors.shape[1]))
        self.states = [np.zeros(start.order) for _ in self.recordings]
        # The structure is linear in its parameters: its slopes are the same everywhere.
        units = np.eye(len(self.structure.parameters)) * self.structure.scales
        moved = [self.structure.build(h) for h in units]
        self.slopes = Slopes(
            *(np.stack([getattr(s, k) - getattr(start, k) for s in moved]) for k in ("A", "B", "C", "D"))
        )

    def local(self, z: Array) -> Local:
        """Return cost, gradient and curvature with the initial states fitted."""
        system = self.structure.build(z * self.structure.scales)
        if not is_stable(system.A, system.dt):
            raise IllConditioned("the predictor is not stable")
        cost, gradient, curvature = 0.0, np.zeros(len(z)), np.zeros((len(z), len(z)))
        for place, r in enumerate(self.recordings):
            found = sweep(system, self.slopes, _inputs(r), r.y, self.states[place], self.whitener)
            value, slope, bend, self.states[place] = eliminate_state(found, len(z), self.states[place])
            cost, gradient, curvature = cost + value, gradient + slope, curvature + bend
        return Local(cost, gradient, curvature)


def _inputs(recording: Recording) -> Array:
    return np.hstack([recording.u, recording.y])


def _balanced(system: StateSpace) -> StateSpace:
    return balanced_truncation(system, system.order).system


def _scaled_predictor(model: InnovationsForm, u: Array, y: Array) -> StateSpace:
    p = model.predictor()
    both = np.concatenate([u, y])
    return StateSpace(p.A, p.B * both, p.C / y[:, None], p.D * both / y[:, None], p.dt)


def _from_predictor(predictor: StateSpace, u: Array, y: Array, recordings: Sequence[Recording]) -> InnovationsForm:
    errors = np.vstack([fitted_errors(predictor, _inputs(r), r.y) for r in recordings])
    covariance = errors.T @ errors / len(errors) * np.outer(y, y)
    m = len(u)
    C, D, K = predictor.C * y[:, None], predictor.D[:, :m] / u * y[:, None], predictor.B[:, m:] / y
    A, B = predictor.A + K @ C, predictor.B[:, :m] / u + K @ D
    return InnovationsForm(StateSpace(A, B, C, D, predictor.dt), K, covariance)


#: Size of one unit of a coordinate, relative to the entries.
_UNIT = 1e-3


def local_structure(system: StateSpace) -> Structure:
    """Return the structure of all discrete systems near this one, of the same order; the nominal values are zero.

    Columns of D that are zero stay zero.
    """
    n, m, p = system.order, system.inputs, system.outputs
    direct = np.flatnonzero(np.broadcast_to(system.D.any(axis=0), (p, m)).ravel())
    directions = linalg.block_diag(_across(system), np.eye(p * m)[:, direct])
    origin = np.concatenate([system.A.ravel(), system.B.ravel(), system.C.ravel(), system.D.ravel()])
    unit = _UNIT * float(np.linalg.norm(origin))

    def build(z: Array) -> StateSpace:
        v = origin + directions @ z
        A, B, C, D = np.split(v, np.cumsum([n * n, n * m, p * n]))
        return StateSpace(A.reshape(n, n), B.reshape(n, m), C.reshape(p, n), D.reshape(p, m), system.dt)

    names = (Parameter(f"z{i + 1}", 0.0, "", unit) for i in range(directions.shape[1]))
    return Structure(tuple(names), build)


def _across(system: StateSpace) -> Array:
    """Return an orthonormal basis of the directions across changes of state coordinates, shape ``(entries, n (m +
    p))``."""
    n, A, B, C = system.order, system.A, system.B, system.C
    along = []
    for T in np.eye(n * n).reshape(n * n, n, n):
        along.append(np.concatenate([(T @ A - A @ T).ravel(), (T @ B).ravel(), -(C @ T).ravel()]))
    return np.asarray(linalg.null_space(np.stack(along)))
