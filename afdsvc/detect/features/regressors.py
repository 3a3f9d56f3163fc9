"""What each fault would add to the white residual, computed from the measured input: ``r = theta_i psi_i + d``.

A fault of severity theta feeds ``w = theta z`` into the plant. With the predictor ``A - Kp C`` of the innovations,

    xh+ = A xh + B u + Kp (y - C xh - D u)          z_i = Cz_i xh + Dzu_i u
    e_i+ = (A - Kp C) e_i + (Bw_i - Kp Dyw_i) z_i    psi_i = C e_i + Dyw_i z_i

For gain faults of a stable plant with output noise only, Kp is 0, z is what truly enters the fault, and the
regression holds exactly for every severity, total loss included; least squares on psi is then maximum likelihood and
also uses what the loop's own noise reveals. Otherwise psi is minus the derivative of the prediction error at theta =
0: correct to first order. ``exact`` distinguishes the two. (The observation is this project's; the setting is the
thesis', chapter 5.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit

from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.features.innovations import StreamingFilter, decay
from afdsvc.detect.features.sums import selection
from afdsvc.detect.uncertain_parameters import uncertain_parameters
from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.lti.lft import AugmentedPlant
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.whitening import innovations

NUDGE = 1e-5  # by which parameters are moved for derivatives
SAME = 1e-9  # share of the entries they are sums of by which two matrices may differ


@dataclass(frozen=True, slots=True, eq=False)
class RegressorState:
    """State of the predictor ``x (n,)`` and of every fault's error filter ``e (K, n)``."""

    x: Array
    e: Array


@dataclass(frozen=True, slots=True, eq=False)
class Regressors:
    """The filters from ``[y, u]`` to the normalised residual ``Li r`` and the normalised ``Li psi_i`` of K faults.

    ``Li`` is the inverse Cholesky factor of the residual's covariance, so the noise in ``Li r`` is white with unit
    covariance. The first ``faults`` of the ``names`` are faults, the others uncertain parameters of the model;
    ``bounds`` are the values they may have, ``sd`` the standard deviations of the uncertain ones. Build one with
    `regressors`.
    """

    names: tuple[str, ...]
    faults: int
    bounds: tuple[tuple[float, float], ...]
    sd: Array
    exact: tuple[bool, ...]
    plant: StateSpace
    Kp: Array
    Bw: Array
    Dyw: Array
    Cz: Array
    Dzu: Array
    Kd: Array
    Li: Array
    rest: RegressorState = field(init=False)

    def __post_init__(self) -> None:
        n = self.plant.order
        object.__setattr__(self, "rest", RegressorState(np.zeros(n), np.zeros((len(self.names), n))))

    @property
    def theta(self) -> Array:
        """What makes psi of the series but its first: they are psi themselves, ``(K, p, K p)``."""
        return selection(len(self.names), self.plant.outputs)

    def start(self) -> RegressorState:
        """Return the state at rest, one object for all who ask."""
        return self.rest

    def step(self, state: RegressorState, r: Array, y: Array, u: Array) -> tuple[RegressorState, Array]:
        """Return the state after the block and the series ``(n, 1 + K, p)``: normalised residual, then every psi."""
        x, e = state.x.copy(), state.e.copy()
        series = np.empty((len(r), 1 + len(self.names), self.plant.outputs))
        g = self.plant
        _run(
            g.A, g.B, g.C, g.D, self.Kp, self.Bw, self.Dyw, self.Cz, self.Dzu, self.Kd, self.Li,
            x, e, _rows(r), _rows(y), _rows(u), series,
        )
        return RegressorState(x, e), series

    def without_faults(self) -> Regressors:
        """Return the filter that only normalises the residual: its cost does not grow with the number of faults."""
        none = slice(0, 0)
        return replace(
            self, names=(), faults=0, bounds=(), sd=self.sd[none], exact=(), Bw=self.Bw[none], Dyw=self.Dyw[none],
            Cz=self.Cz[none], Dzu=self.Dzu[none], Kd=self.Kd[none],
        )

    def settling(self, to: float = 1e-4) -> int:
        """Return after how many samples an unknown initial state has decayed to the share ``to``."""
        A = self.plant.A - self.Kp @ self.plant.C
        return decay(StateSpace(A, self.plant.B, self.plant.C, self.plant.D, self.plant.dt), to)


def regressors(problem: DetectionProblem) -> Regressors:
    """Return the regressors of every fault, then of every uncertain parameter; raises `BadInput` when the innovations
    do not belong to the plant.

    A fault with several channels (``w = theta z`` with vectors w and z) is one regressor. Problems that differ in their false
    alarms only, as those of the detectors of one machine do, get the same object.
    """
    return problem.once(lambda: _regressors(problem), "regressors")


def without_faults(problem: DetectionProblem) -> Regressors:
    """Return the filter of a problem that only normalises the residual."""
    return problem.once(lambda: regressors(problem).without_faults(), "normalised residual")


def _regressors(problem: DetectionProblem) -> Regressors:
    g = problem.augmented.plant
    Kp, uncertain = predictor_gain(problem, g), uncertain_parameters(problem)
    ways = [_way(problem, problem.augmented, name, Kp) for name in problem.fault_names]
    if problem.uncertain is not None:
        ways += [_way(problem, problem.uncertain, name, Kp) for name in uncertain]
    width = max((way.Bw.shape[1] for way in ways), default=1)
    n, m, p, K = g.order, g.inputs, g.outputs, len(ways)
    Bw, Dyw = np.zeros((K, n, width)), np.zeros((K, p, width))
    Cz, Dzu, Kd = np.zeros((K, width, n)), np.zeros((K, width, m)), np.zeros((K, n, p))
    for i, way in enumerate(ways):
        r = way.Bw.shape[1]
        Bw[i, :, :r], Dyw[i, :, :r], Cz[i, :r], Dzu[i, :r] = way.Bw, way.Dyw, way.Cz, way.Dzu
        Kd[i] = way.Kd
    sd = np.array(list(uncertain.values()))
    bounds = (problem.severity_range,) * len(problem.fault_names) + tuple((-4 * s, 4 * s) for s in sd.tolist())
    names, exact = (*problem.fault_names, *uncertain), tuple(way.exact for way in ways)
    return Regressors(
        names, len(problem.fault_names), bounds, sd, exact, g, Kp, Bw, Dyw, Cz, Dzu, Kd, whitener(problem.covariance)
    )


@dataclass(frozen=True, slots=True, eq=False)
class FaultyResidual:
    """The normalised residual of a machine with a fault: of its own predictor, in the covariance it has there."""

    filter: StreamingFilter
    Li: Array

    def start(self) -> Array:
        """Return the state at rest."""
        return self.filter.start()

    def step(self, state: Array, r: Array, y: Array, u: Array) -> tuple[Array, Array]:
        """Return the state after the block and the series ``(n, 1, p)``; the residual ``r`` of the healthy machine is not used."""
        after, own = self.filter.step(state, np.hstack([y, u]))
        return after, (own @ self.Li.T)[:, None]


def faulty_residual(problem: DetectionProblem, severities: Mapping[str, float]) -> FaultyResidual | None:
    """Return the residual of the machine with faults, or with other values of uncertain parameters; None where its noises are not stated,
    leave no steady predictor, or both kinds are asked for."""
    faults = problem.augmented if set(severities) <= set(problem.fault_names) else problem.uncertain
    if problem.output_cov is None or faults is None or not set(severities) <= set(faults.fault_names):
        return None
    try:
        found = innovations(faults.close(severities), problem.output_cov, problem.process_cov, problem.cross_cov)
    except AfdsvcError:
        return None
    return FaultyResidual(StreamingFilter(found.filter), whitener(found.covariance))


@dataclass(frozen=True, slots=True, eq=False)
class _Way:
    """How one parameter enters: from its z into the error filter and the residual, what its z is made of, and how the
    predictor's gain follows it."""

    Bw: Array
    Dyw: Array
    Cz: Array
    Dzu: Array
    Kd: Array
    exact: bool


def _way(problem: DetectionProblem, augmented: AugmentedPlant, name: str, Kp: Array) -> _Way:
    s, k, own = augmented.system, augmented.channels, augmented.channels_of(name)
    no_state = not Kp.any() or not s.C[own].any()  # then z is known without error, not estimated
    exact = no_state and not s.D[own, own].any() and no_return(s, own)
    Kd = np.zeros_like(Kp) if no_state else _gain_derivative(problem, augmented, name)
    return _Way(s.B[:, own] - Kp @ s.D[k:, own], s.D[k:, own], s.C[own], s.D[own, k:], Kd, exact)


def _gain_derivative(problem: DetectionProblem, augmented: AugmentedPlant, name: str) -> Array:
    """Return how the optimal predictor's gain changes with the parameter; 0 where the noises are not stated."""
    n, p = augmented.plant.order, augmented.plant.outputs
    if problem.output_cov is None:
        return np.zeros((n, p))
    plants = [augmented.close({name: s * NUDGE}) for s in (1, -1)]
    gains = [innovations(g, problem.output_cov, problem.process_cov, problem.cross_cov).gain for g in plants]
    return np.asarray((gains[0] - gains[1]) / (2 * NUDGE))


def covariance_slopes(problem: DetectionProblem) -> Array:
    """Return how the covariance of the normalised innovations changes with every fault and uncertain parameter, shape ``(K, p, p)``; 0 where
    the noises are not stated."""
    return problem.once(lambda: _covariance_slopes(problem), "covariance slopes")


def _covariance_slopes(problem: DetectionProblem) -> Array:
    names, Li = regressors(problem).names, whitener(problem.covariance)
    pairs = [[faulty_residual(problem, {name: s * NUDGE}) for s in (1, -1)] for name in names]
    both = [[np.zeros_like(Li) if f is None else np.linalg.inv(f.Li.T @ f.Li) for f in pair] for pair in pairs]
    return np.array([Li @ (up - down) @ Li.T / (2 * NUDGE) for up, down in both]).reshape(len(names), *Li.shape)


def whitener(covariance: Array) -> Array:
    """Return ``L^-1`` with ``L L' = covariance``; raises `BadInput` when the covariance is not positive definite."""
    Xi = np.atleast_2d(np.asarray(covariance, dtype=float))
    try:
        if not np.isfinite(Xi).all() or not np.allclose(Xi, Xi.T, atol=0):
            raise np.linalg.LinAlgError
        return np.asarray(np.linalg.inv(np.linalg.cholesky(Xi)))
    except np.linalg.LinAlgError:
        raise BadInput(
            f"residual covariance {Xi.tolist()} is not a covariance; expected a symmetric, positive definite matrix "
            "(state the noise of every output)"
        ) from None


def predictor_gain(problem: DetectionProblem, plant: StateSpace) -> Array:
    """Return Kp, shape ``(n, p)``, read from the innovations filter."""
    f, p = problem.innovations, plant.outputs
    if f.inputs != p + plant.inputs or f.outputs != p:
        raise BadInput(f"the residual filter is {f.outputs} x {f.inputs}; expected {p} x {p + plant.inputs}")
    if f.order == 0 and plant.order == 0:
        return np.zeros((0, p))
    Kp = f.B[:, :p] if f.order == plant.order else np.full((plant.order, p), np.nan)
    parts = np.abs(plant.A) + np.abs(Kp) @ np.abs(plant.C)  # entry by entry: states may have any units
    if not (np.abs(f.A - (plant.A - Kp @ plant.C)) <= SAME * parts).all():
        raise BadInput("the residual filter is not the predictor A - Kp C of the plant; both must share their states")
    return np.asarray(Kp)


def noise_sources(problem: DetectionProblem) -> tuple[Array, Array]:
    """Return how unit white noise enters states ``(n, q)`` and measured outputs ``(p, q)``: the stated process and sensor noise, or the
    innovations ``x+ = .. + Kp r, y = .. + r`` where those are not stated."""
    g = problem.augmented.plant
    if problem.output_cov is None:
        root = np.array(np.linalg.inv(whitener(problem.covariance)), dtype=np.float64)
        return np.asarray(predictor_gain(problem, g) @ root), root
    Q = np.zeros((g.order, g.order)) if problem.process_cov is None else problem.process_cov
    S = np.zeros((g.order, g.outputs)) if problem.cross_cov is None else problem.cross_cov
    joint = np.block([[Q, S], [S.T, problem.output_cov]])
    size = np.sqrt(np.diag(joint))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(joint / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(root[: g.order]), np.asarray(root[g.order :])


def no_return(s: StateSpace, channels: slice) -> bool:
    """Whether w of this fault never reaches its own z through the plant (checked on the Markov parameters)."""
    x = s.B[:, channels]
    for _ in range(s.order):
        if np.abs(s.C[channels] @ x).max(initial=0.0) > 0:
            return False
        x = s.A @ x
    return True


def _rows(a: Array) -> Array:
    return np.require(a, np.float64, ("C", "W"))


@njit(cache=True)
def _run(A, B, C, D, Kp, Bw, Dyw, Cz, Dzu, Kd, Li, x, e, r, y, u, series):  # type: ignore[no-untyped-def]
    n, p, K, width = x.size, y.shape[1], e.shape[0], Bw.shape[2]
    innovation, new, raw, seen, z = np.zeros(p), np.zeros(n), np.zeros(p), np.zeros(p), np.zeros(width)
    for k in range(r.shape[0]):
        innovation[:] = y[k]
        _add(C, x, innovation, -1.0)
        _add(D, u[k], innovation, -1.0)
        series[k, 0] = 0.0
        _add(Li, r[k], series[k, 0], 1.0)
        for f in range(K):
            z[:] = 0.0
            _add(Cz[f], x, z, 1.0)
            _add(Dzu[f], u[k], z, 1.0)
            seen[:] = 0.0
            _add(C, e[f], seen, 1.0)
            raw[:] = seen
            _add(Dyw[f], z, raw, 1.0)
            series[k, 1 + f] = 0.0
            _add(Li, raw, series[k, 1 + f], 1.0)
            new[:] = 0.0
            _add(A, e[f], new, 1.0)
            _add(Kp, seen, new, -1.0)
            _add(Bw[f], z, new, 1.0)
            _add(Kd[f], innovation, new, 1.0)
            e[f] = new
        new[:] = 0.0
        _add(A, x, new, 1.0)
        _add(B, u[k], new, 1.0)
        _add(Kp, innovation, new, 1.0)
        x[:] = new


@njit(cache=True, inline="always")
def _add(M, v, out, sign):  # type: ignore[no-untyped-def]
    """Add ``sign M v`` to ``out``, always in the same order."""
    for i in range(out.size):
        s = 0.0
        for j in range(v.size):
            s += M[i, j] * v[j]
        out[i] += sign * s
