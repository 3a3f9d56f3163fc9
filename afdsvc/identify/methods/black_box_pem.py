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

from afdsvc.dataset.arrays import InputOutputData, scale_recordings, scales
from afdsvc.errors import IllConditioned
from afdsvc.identify.fit import ResponseBand, sandwich_band
from afdsvc.identify.numerics.innovations_form import InnovationsForm, fitted_errors
from afdsvc.identify.numerics.prediction_errors import eliminate_state, sweep, whitening_of
from afdsvc.identify.parameters.noise_structure import Slopes
from afdsvc.identify.parameters.structure import FreeParameter, Structure
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.reduce import balanced_truncation
from afdsvc.lti.stability import describe_pole, is_stable, worst_pole
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.stats.levenberg_marquardt import Local, descend

#: Steps after which the coordinates are renewed, and decrease of the log-likelihood that is statistically nothing.
_LONGEST, _TOLERANCE = 15, 1e-2
#: Decrease of the logarithm of the determinant of the errors' covariance below which another round is not worth its time.
_GAIN = 1e-4
#: Smallest relative variance of the errors: an exact fit has a determinant too.
_LEAST = 1e-24


def black_box_pem(model: InnovationsForm, recordings: Sequence[InputOutputData], noise: bool = True) -> InnovationsForm:
    """Return the innovations form of the same order that predicts the recordings best, near the one handed in.

    Without ``noise`` it is the output error that is minimised: the gain is zero, the prediction a simulation from u alone, consistent in open
    loop whatever the colour of the noise. Raises `IllConditioned` when the predictor (the plant, without ``noise``) is not stable.
    """
    return best_black_box([model], recordings, noise)


def best_black_box(models: Sequence[InnovationsForm], recordings: Sequence[InputOutputData], noise: bool = True, steps: int = 40) -> InnovationsForm:
    """Return `black_box_pem` from that of several starting points which reaches the lowest determinant of the errors' covariance.

    At most ``steps`` steps from each. A starting point with an unstable predictor is left out; raises the `IllConditioned` of the last one where none is left.
    """
    recordings = [_with_constant(r) for r in recordings]
    u, y = scales(recordings)
    relative = scale_recordings(recordings, u, y)
    found: list[tuple[float, StateSpace]] = []
    failure = IllConditioned("no starting point was handed in; expected at least one")
    for model in models:
        try:
            found.append(_descended(_scaled_predictor(_driven_by_constant(model), u, y, noise), relative, steps))
        except IllConditioned as error:
            failure = error
    if not found:
        raise failure
    best = _from_predictor(min(found, key=lambda f: f[0])[1], u, y, relative)
    return InnovationsForm(best.system.select(slice(None), slice(0, -1)), best.gain, best.covariance)


def black_box_band(model: InnovationsForm, recordings: Sequence[InputOutputData], omega: Array, noise: bool = True, groups: int = 16) -> ResponseBand:
    """Return the frequency response of a model that `black_box_pem` found, with its covariance (`sandwich_band`)."""
    recordings = [_with_constant(r) for r in recordings]
    u, y = scales(recordings)
    relative = scale_recordings(recordings, u, y)
    objective = _Prediction(local_structure(_balanced(_scaled_predictor(_driven_by_constant(model), u, y, noise))), relative)
    structure = objective.structure
    origin = np.zeros(len(structure.parameters))
    curvature, parts = objective.local(origin).curvature, objective.group_gradients(origin, groups)
    return sandwich_band(
        lambda z: frequency_response(_in_units(structure.build(z * structure.scales), u, y)[0], omega)[:, :, :-1], curvature, parts, omega
    )


def _with_constant(r: InputOutputData) -> InputOutputData:
    """Return the recording with a constant input: without it a mode at 1 takes the place of an operating point that the means miss."""
    return InputOutputData(np.hstack([r.u, np.ones((len(r), 1))]), r.y, r.dt, r.name)


def _driven_by_constant(model: InnovationsForm) -> InnovationsForm:
    s = model.system
    B, D = (np.hstack([M, np.zeros((len(M), 1))]) for M in (s.B, s.D))
    return InnovationsForm(StateSpace(s.A, B, s.C, D, s.dt), model.gain, model.covariance)


def _descended(predictor: StateSpace, recordings: Sequence[InputOutputData], steps: int) -> tuple[float, StateSpace]:
    """Return the logarithm of the determinant of the errors' covariance at the minimum near a predictor, and the predictor there."""
    if not is_stable(predictor.A, predictor.dt):
        raise IllConditioned(f"the predictor has the pole {describe_pole(worst_pole(predictor.A, predictor.dt)[0], predictor.dt)}; lower the order")
    held = [(_log_det(predictor, recordings), predictor)]
    while steps > 0:  # coordinates, and the weight of the errors, belong to where they are
        objective = _Prediction(local_structure(_balanced(held[-1][1])), recordings)
        z = np.zeros(len(objective.structure.parameters))
        unbounded = np.full(len(z), np.inf)
        best = descend(objective.local, z, -unbounded, unbounded, min(steps, _LONGEST), _TOLERANCE)
        steps -= best.steps
        predictor = objective.structure.build(best.point * objective.structure.scales)
        held.append((_log_det(predictor, recordings), predictor))
        if best.steps <= 1 or held[-1][0] > held[-2][0] - _GAIN:
            break
    return min(held, key=lambda h: h[0])


def _log_det(predictor: StateSpace, recordings: Sequence[InputOutputData]) -> float:
    errors = np.vstack([fitted_errors(predictor, _inputs(r, predictor), r.y) for r in recordings])
    return float(np.linalg.slogdet(errors.T @ errors / len(errors) + _LEAST * np.eye(errors.shape[1]))[1])


@dataclass(eq=False)
class _Prediction:
    """Half the sum of the squared prediction errors, weighted with their covariance at the start."""

    structure: Structure
    recordings: Sequence[InputOutputData]

    def __post_init__(self) -> None:
        start = self.structure.build(np.zeros(len(self.structure.parameters)))
        errors = np.vstack([fitted_errors(start, _inputs(r, start), r.y) for r in self.recordings])
        self.whitener = whitening_of(errors.T @ errors / len(errors) + _LEAST * np.eye(errors.shape[1]))
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
            found = sweep(system, self.slopes, _inputs(r, system), r.y, self.states[place], self.whitener)
            value, slope, bend, self.states[place] = eliminate_state(found, len(z), self.states[place])
            cost, gradient, curvature = cost + value, gradient + slope, curvature + bend
        return Local(cost, gradient, curvature)


    def group_gradients(self, z: Array, groups: int) -> Array:
        """Return the gradient group of samples by group of samples, ``(about groups, q)``, the initial states fitted by `local` before."""
        system, q = self.structure.build(z * self.structure.scales), len(z)
        block, parts = max(1, -(-sum(map(len, self.recordings)) // groups)), []
        for state, r in zip(self.states, self.recordings, strict=True):
            found = sweep(system, self.slopes, _inputs(r, system), r.y, state, self.whitener, block=block)
            coupling = linalg.lstsq(found.matrix[q:, q:], found.matrix[q:, :q])[0]
            parts.append(found.gradients[:, :q] - found.gradients[:, q:] @ coupling)
        return np.vstack(parts)


def _inputs(recording: InputOutputData, predictor: StateSpace) -> Array:
    """Return what a predictor is driven by: u and y, or u alone where its noise model is fixed at none."""
    return np.hstack([recording.u, recording.y]) if predictor.inputs > recording.u.shape[1] else recording.u


def _balanced(system: StateSpace) -> StateSpace:
    return balanced_truncation(system, system.order).system


def _scaled_predictor(model: InnovationsForm, u: Array, y: Array, noise: bool) -> StateSpace:
    p = model.predictor() if noise else model.system
    both = np.concatenate([u, y])[: p.inputs]
    return StateSpace(p.A, p.B * both, p.C / y[:, None], p.D * both / y[:, None], p.dt)


def _from_predictor(predictor: StateSpace, u: Array, y: Array, recordings: Sequence[InputOutputData]) -> InnovationsForm:
    errors = np.vstack([fitted_errors(predictor, _inputs(r, predictor), r.y) for r in recordings])
    return InnovationsForm(*_in_units(predictor, u, y), errors.T @ errors / len(errors) * np.outer(y, y))


def _in_units(predictor: StateSpace, u: Array, y: Array) -> tuple[StateSpace, Array]:
    """Return plant and gain of a predictor of scaled signals, in the signals' own units."""
    m = len(u)
    C, D, B = predictor.C * y[:, None], predictor.D[:, :m] / u * y[:, None], predictor.B[:, :m] / u
    K = predictor.B[:, m:] / y if predictor.inputs > m else np.zeros((predictor.order, len(y)))
    return StateSpace(predictor.A + K @ C, B + K @ D, C, D, predictor.dt), K


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

    names = (FreeParameter(f"z{i + 1}", 0.0, "", unit) for i in range(directions.shape[1]))
    return Structure(tuple(names), build)


def _across(system: StateSpace) -> Array:
    """Return an orthonormal basis of the directions across changes of state coordinates, shape ``(entries, n (m +
    p))``."""
    n, A, B, C = system.order, system.A, system.B, system.C
    along = []
    for T in np.eye(n * n).reshape(n * n, n, n):
        along.append(np.concatenate([(T @ A - A @ T).ravel(), (T @ B).ravel(), -(C @ T).ravel()]))
    return np.asarray(linalg.null_space(np.stack(along)))
