"""Reduction of G(S), which is of high order, with the least change of the closed loop.

Four ways, tried side by side and judged by the loop they leave:

- ``balanced``: balanced truncation of the plant, blind to the loop;
- ``frequency_weighted``: weighted with the spectrum of the plant's recorded input;
- ``closed_loop``: weighted with the loop's sensitivities (Enns), where the loop looks;
- ``coprime``: balanced truncation of ``[M + U S; N + V S]``, which is the loop itself from alpha to ``[u; y]``; the
  plant is the quotient of the remaining factors. Serves unstable plants as well (Meyer, IEEE Trans. Automatic Control 35, 1990).

Refinement against the recordings: a truncation throws away what is small in some norm; here the distance that counts is ``|beta - S(G) alpha|`` on the
recordings, over all plants G of the order, started from a truncation. The excitation alpha is free of noise, so the
estimate is consistent whatever the colour of the noise, and a plant that the controller does not stabilise cannot come
out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.identify.fit import ResponseBand, sandwich_band
from afdsvc.identify.methods.black_box_pem import local_structure
from afdsvc.identify.methods.hansen import excited_loop, loop_is_stable
from afdsvc.identify.methods.indirect import Mismatch
from afdsvc.identify.numerics.impulse_fit import approach
from afdsvc.identify.numerics.innovations_form import fitted_errors
from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.reduce import balanced_truncation, closed_loop_truncation, weighted_truncation
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import Array, ComplexArray, StateSpace, block_diagonal
from afdsvc.lti.yjbk import deviation_system, exchange

TRUNCATIONS = ("balanced", "frequency_weighted", "closed_loop", "coprime")


@dataclass(frozen=True, slots=True, eq=False)
class ReducedPlant:
    """One reduction and what it costs.

    ``plant_error`` and ``loop_error`` are the largest error of the frequency response of the plant, and of the loop
    from alpha to ``[u, y]``, relative to the largest response (signals in units of their scale); ``loop_error`` is inf
    when the loop is unstable. ``failure`` says why a method gave nothing.
    """

    method: str
    system: StateSpace | None
    loop_stable: bool
    plant_error: float
    loop_error: float
    failure: str = ""


def compare_reductions(
    plant: StateSpace,
    fact: Factorisation,
    order: int,
    recordings: Sequence[InputOutputData] = (),
    methods: Sequence[str] = TRUNCATIONS,
) -> list[ReducedPlant]:
    """Return all reductions of the plant to ``order``, the one that disturbs the loop least first.

    ``recordings`` of u and y give the scales of the signals and the weight of ``frequency_weighted``. Raises `BadInput`
    for an unknown method, or when the order exceeds the plant's.
    """
    unknown = [method for method in methods if method not in TRUNCATIONS]
    if unknown:
        raise BadInput(f"reduction method '{unknown[0]}'; expected one of {', '.join(TRUNCATIONS)}")
    if order > plant.order:
        raise BadInput(
            f"a plant of order {plant.order} cannot be reduced to order {order}; expected at most {plant.order}"
        )
    u_scale, y_scale = _scales(recordings, plant)
    ways: dict[str, Callable[[], StateSpace]] = {
        "balanced": lambda: _in_scale(plant, u_scale, y_scale, lambda g: balanced_truncation(g, order).system),
        "frequency_weighted": lambda: _frequency_weighted(plant, order, recordings, u_scale, y_scale),
        "closed_loop": lambda: _closed_loop(plant, fact.controller, order, u_scale, y_scale),
        "coprime": lambda: _coprime(plant, fact, order, u_scale, y_scale),
    }
    results = [_judged(method, ways[method], plant, fact, u_scale, y_scale) for method in methods]
    return sorted(results, key=lambda r: r.loop_error)


def reduction_cost(
    method: str, reduced: StateSpace, plant: StateSpace, fact: Factorisation, recordings: Sequence[InputOutputData]
) -> ReducedPlant:
    """Return what a reduction found elsewhere costs, measured like the others."""
    return _judged(method, lambda: reduced, plant, fact, *_scales(recordings, plant))


def _judged(
    method: str,
    reduce: Callable[[], StateSpace],
    plant: StateSpace,
    fact: Factorisation,
    u_scale: Array,
    y_scale: Array,
) -> ReducedPlant:
    try:
        reduced = reduce()
    except AfdsvcError as error:
        return ReducedPlant(method, None, False, float("inf"), float("inf"), str(error))
    omega = np.linspace(0.002, 0.998, 300) * np.pi / plant.dt
    open_loop = _distance(frequency_response(plant, omega), frequency_response(reduced, omega), y_scale, u_scale)
    if not loop_is_stable(reduced, fact.controller):
        return ReducedPlant(method, reduced, False, open_loop, float("inf"), "the controller does not stabilise it")
    whole, less = (frequency_response(excited_loop(fact, g), omega) for g in (plant, reduced))
    closed_loop = _distance(whole, less, np.concatenate([u_scale, y_scale]), u_scale)
    return ReducedPlant(method, reduced, True, open_loop, closed_loop)


def _distance(a: ComplexArray, b: ComplexArray, out_scale: Array, in_scale: Array) -> float:
    scale = in_scale[None, None, :] / out_scale[None, :, None]
    gap, size = (np.linalg.norm(x * scale, ord=2, axis=(1, 2)).max() for x in (a - b, a))
    return float(gap / size)


def _scales(recordings: Sequence[InputOutputData], plant: StateSpace) -> tuple[Array, Array]:
    if not recordings:
        return np.ones(plant.inputs), np.ones(plant.outputs)
    u, y = np.vstack([r.u for r in recordings]), np.vstack([r.y for r in recordings])
    return np.maximum(u.std(axis=0), 1e-300), np.maximum(y.std(axis=0), 1e-300)


def _in_scale(plant: StateSpace, u: Array, y: Array, reduce: Callable[[StateSpace], StateSpace]) -> StateSpace:
    """Apply a reduction in units of the signals' scales."""
    r = reduce(StateSpace(plant.A, plant.B * u, plant.C / y[:, None], plant.D * u / y[:, None], plant.dt))
    return StateSpace(r.A, r.B / u, r.C * y[:, None], r.D / u * y[:, None], r.dt)


def _frequency_weighted(
    plant: StateSpace, order: int, recordings: Sequence[InputOutputData], u_scale: Array, y_scale: Array
) -> StateSpace:
    if not recordings:
        raise BadInput("the frequency-weighted reduction needs recordings of the plant's input; found none")
    relative = np.vstack([r.u - r.u.mean(axis=0) for r in recordings]) / u_scale
    weight = block_diagonal(*(_shaping_filter(column, plant.dt) for column in relative.T))
    return _in_scale(plant, u_scale, y_scale, lambda g: weighted_truncation(g, order, input_weight=weight).system)


def _shaping_filter(u: Array, dt: float, lags: int = 20) -> StateSpace:
    """Return the autoregressive filter with the spectrum of a signal (Yule-Walker), which is stable by construction."""
    correlation = np.asarray([u[: len(u) - k] @ u[k:] for k in range(lags + 1)]) / len(u)
    correlation[0] *= 1 + 1e-6
    a = linalg.solve_toeplitz(correlation[:-1], correlation[1:])
    A = np.vstack([a, np.eye(lags)[:-1]])
    gain = float(np.sqrt(max(correlation[0] - a @ correlation[1:], 1e-12 * correlation[0])))
    return StateSpace(A, gain * np.eye(lags)[:, :1], a[None, :], np.array([[gain]]), dt)


def _closed_loop(plant: StateSpace, controller: StateSpace, order: int, u: Array, y: Array) -> StateSpace:
    scaled = StateSpace(
        controller.A, controller.B * y, controller.C / u[:, None], controller.D * y / u[:, None], controller.dt
    )
    return _in_scale(plant, u, y, lambda g: closed_loop_truncation(g, scaled, order).system)


def _coprime(plant: StateSpace, fact: Factorisation, order: int, u: Array, y: Array) -> StateSpace:
    m, scale = plant.inputs, np.concatenate([u, y])
    loop = excited_loop(fact, plant)
    relative = StateSpace(loop.A, loop.B * u, loop.C / scale[:, None], loop.D * u / scale[:, None], loop.dt)
    r = balanced_truncation(relative, order).system
    graph = StateSpace(r.A, r.B / u, r.C * scale[:, None], r.D / u * scale[:, None], r.dt)
    return exchange(graph, range(m), range(m)).select(slice(m, None), slice(None))


_RESTARTS = 4
#: Longest autoregression of the noise, and how often it is estimated: once more when its colour no longer misleads the fit.
_NOISE_LAGS, _COLOURINGS = 20, 2


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """The refined plant, the mean square of what remains unexplained (relative to the start), and the objective
    there."""

    system: StateSpace
    gain: float
    objective: Mismatch
    point: Array

    def criterion(self) -> float:
        """Return the Bayesian information criterion of the errors, as the objective whitens them."""
        samples = sum(map(len, self.objective.recordings))
        covariance = self.objective.error_covariance(self.point * self.objective.structure.scales)
        return float(samples * np.linalg.slogdet(covariance)[1] + len(self.point) * np.log(samples))

    def band(self, omega: Array, groups: int = 16) -> ResponseBand:
        """Return the frequency response with its covariance (`sandwich_band`)."""
        local, parts = self.objective.local(self.point), self.objective.group_gradients(self.point, groups)
        structure = self.objective.structure

        def response(z: Array) -> ComplexArray:
            return frequency_response(structure.build((self.point + z) * structure.scales), omega)

        return sandwich_band(response, local.curvature, parts, omega)


def noise_whitener(errors: Sequence[Array], dt: float) -> StateSpace:
    """Return the filter that whitens errors, an autoregression of them all, its length by the Bayesian information criterion (Lütkepohl, 2005)."""
    p, samples = errors[0].shape[1], sum(map(len, errors))
    most = min(_NOISE_LAGS, samples // (20 * p))
    rows = np.vstack([np.hstack([e[most - k : len(e) - k] for k in range(most + 1)]) for e in errors])  # now, one sample ago, ...
    fits = [linalg.lstsq(rows[:, p : p * (k + 1)], rows[:, :p])[0] if k else np.zeros((0, p)) for k in range(most + 1)]
    left = [rows[:, :p] - rows[:, p : p * (k + 1)] @ weights for k, weights in enumerate(fits)]
    criteria = [len(rows) * np.linalg.slogdet(e.T @ e / len(e))[1] + k * p * p * np.log(len(rows)) for k, e in enumerate(left)]
    k = int(np.argmin(criteria))
    shift = np.eye(k * p, k=-p)
    return StateSpace(shift, np.eye(k * p, p), -fits[k].T, np.eye(p), dt)


def refine(
    fact: Factorisation, signals: Sequence[InputOutputData], start: StateSpace, whitener: StateSpace | None = None
) -> Refinement:
    """Return the plant of the order of ``start`` whose S explains ``signals`` (alpha as u, beta as y) best.

    Correlations bring the start near at a cost that does not grow with the recordings; sweeps over the samples have
    the last word, so neither the start nor where an impulse response was cut off is left in the result. ``whitener``
    filters beta before the sweeps: without it every frequency counts alike, however noisy it is.
    """
    return _swept(_near(fact, signals, start, whitener), signals)


def _near(fact: Factorisation, signals: Sequence[InputOutputData], start: StateSpace, whitener: StateSpace | None) -> Refinement:
    """Return where correlations lead from a start, the start itself where that is better."""
    given = _objective(fact, signals, start, whitener)
    best = min((_objective(fact, signals, approach(fact, signals, _balanced(start)), whitener), given), key=_left)
    z = np.zeros(len(best.structure.parameters))
    return Refinement(best.structure.build(z), _left(best) / _left(given), best, z)


def refine_from(
    fact: Factorisation, signals: Sequence[InputOutputData], starts: Sequence[StateSpace], whitener: StateSpace | None = None
) -> Refinement:
    """Return the best `refine` from several starts, with beta whitened by a noise model estimated from what it leaves unless ``whitener`` is given.

    The search has local minima. Of those reached, the one with the smallest Bayesian information criterion counts: a start without feedthrough stays
    without, and competes with one that has it. Raises the error of the last start where none succeeds.
    """
    found, failure = _reached(starts, lambda start: _near(fact, signals, start, whitener))
    if not found:
        raise failure
    for _ in range(_COLOURINGS if whitener is None else 1):
        colour = whitener or _colour(fact, signals, min(found, key=Refinement.criterion).system)
        different = {round(f.criterion()): f for f in found}.values()  # starts that led to the same minimum count once
        swept = [_swept(Refinement(f.system, f.gain, _objective(fact, signals, f.system, colour), 0 * f.point), signals) for f in different]
        found = [min(swept, key=Refinement.criterion)]
    return found[0]


def _colour(fact: Factorisation, signals: Sequence[InputOutputData], plant: StateSpace) -> StateSpace:
    """Return the filter that whitens what a plant leaves of beta."""
    S = deviation_system(fact, plant)
    return noise_whitener([fitted_errors(S, r.u, r.y) for r in signals], plant.dt)


def _reached(starts: Sequence[StateSpace], reach: Callable[[StateSpace], Refinement]) -> tuple[list[Refinement], AfdsvcError]:
    """Return what every start leads to, and the last failure."""
    found: list[Refinement] = []
    failure: AfdsvcError = BadInput("no starting point was handed in; expected at least one")
    for start in starts:
        try:
            found.append(reach(start))
        except AfdsvcError as error:
            failure = error
    return found, failure


def _swept(near: Refinement, signals: Sequence[InputOutputData]) -> Refinement:
    """Return the minimum that sweeps over the samples find near where correlations led."""
    objective, found = near.objective, near
    first = _left(objective) / near.gain
    for _ in range(_RESTARTS):  # the coordinates are those of the point they start from
        before, z = _left(objective), np.zeros(len(objective.structure.parameters))
        unbounded = np.full(len(z), np.inf)
        best, _ = objective.minimise(z, -unbounded, unbounded)
        system = objective.structure.build(best.point * objective.structure.scales)
        found = Refinement(system, _left(objective, best.point) / first, objective, best.point)
        if found.gain * first > before * (1 - 1e-4):
            break
        objective = _objective(objective.fact, signals, system, objective.whitener)
    return found


def _objective(
    fact: Factorisation, signals: Sequence[InputOutputData], around: StateSpace, whitener: StateSpace | None
) -> Mismatch:
    objective = Mismatch(local_structure(_balanced(around)), fact, signals, 2, whitener)
    if whitener is not None:
        objective.tolerance = 1e-2  # flat directions of a weighted fit take long to walk and change nothing
    return objective


def _left(objective: Mismatch, z: Array | None = None) -> float:
    """Return the mean square of what the plant at z (at the origin of the coordinates) leaves unexplained."""
    z = np.zeros(len(objective.structure.parameters)) if z is None else z
    return float(np.trace(objective.error_covariance(z * objective.structure.scales)))


def _balanced(system: StateSpace) -> StateSpace:
    return balanced_truncation(system, system.order).system if is_stable(system.A, system.dt) else system
