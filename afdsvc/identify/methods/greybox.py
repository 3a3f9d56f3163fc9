"""Grey-box identification by prediction errors: physical parameters and noise intensities by maximum likelihood.

The plant's structure is known, its parameters are not. The one-step prediction error of the innovations form is white
when the model is right, in open and in closed loop alike (Ljung, System Identification, 1999, chapters 7 and 13), so
the input may answer to the output. Gaussian log-likelihood, exact gradients (`noisy_structure`, `sweep`), Fisher
scoring with Levenberg-Marquardt damping, standard errors from the information matrix, several recordings with their own
initial states.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import AfdsvcError, BadInput, IllConditioned
from afdsvc.identify.fit import Fit, ParameterEstimate, ResponseBand
from afdsvc.identify.numerics.innovations_form import InnovationsForm, fitted_errors
from afdsvc.identify.numerics.prediction_errors import eliminate_state, sweep, whitening_of
from afdsvc.identify.parameters.noise_structure import PredictorPoint, plant_point, predictor_point
from afdsvc.identify.parameters.structure import Structure
from afdsvc.identify.settings import SETTINGS
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.stability import is_stable, worst_pole
from afdsvc.lti.statespace import Array
from afdsvc.stats.levenberg_marquardt import Local, Minimum, descend


@dataclass(frozen=True, slots=True)
class GreyboxOptions:
    """``starts`` counts the starting points (the first is nominal, the others are drawn from the prior, widened by
    ``spread``); ``prior`` adds the stated prior to the likelihood; ``steps`` bounds the iterations.
    """

    starts: int = 1
    spread: float = 3.0
    prior: bool = False
    steps: int = 60


def fit_greybox(
    structure: Structure,
    recordings: Sequence[InputOutputData],
    options: GreyboxOptions = GreyboxOptions(),
    rng: np.random.Generator | None = None,
    start: Array | None = None,
) -> Fit:
    """Return the maximum-likelihood fit; ``start`` replaces the nominal values, ``rng`` is needed for several starts.

    Raises `BadInput` when a parameter has no influence on the recordings or cannot be separated from the others.
    """
    objective = Likelihood(structure, recordings, options.prior)
    minima, failures = [], []
    for theta in _starts(structure, options, rng, start):
        try:
            minima.append(objective.minimise(theta, options.steps))
        except AfdsvcError as error:
            failures.append(error)
    if not minima:
        raise failures[0]
    best = min(minima, key=lambda m: m.local.cost)
    notes = _notes(minima, best, len(failures))
    return _fit(objective, best, notes)


def _starts(
    structure: Structure, options: GreyboxOptions, rng: np.random.Generator | None, start: Array | None
) -> list[Array]:
    first = structure.values if start is None else np.asarray(start, dtype=np.float64)
    if first.shape != structure.values.shape:
        raise BadInput(f"start values of shape {first.shape}; expected {structure.values.shape}")
    if options.starts > 1 and rng is None:
        raise BadInput(f"{options.starts} starting points need a random generator; pass rng")
    lower, upper = _bounds(structure)
    draws = [rng.standard_normal(len(first)) for _ in range(options.starts - 1)] if rng is not None else []
    return [first] + [np.clip(first + options.spread * structure.scales * z, lower, upper) for z in draws]


def _bounds(structure: Structure) -> tuple[Array, Array]:
    return np.asarray([p.lower for p in structure.parameters]), np.asarray([p.upper for p in structure.parameters])


class Likelihood:
    """The negative log-likelihood over ``z = [theta / scale, log noise]``, remembering initial states between calls."""

    def __init__(self, structure: Structure, recordings: Sequence[InputOutputData], prior: bool) -> None:
        self.structure, self.recordings, self.prior = structure, list(recordings), prior
        self.scales, self.count = structure.scales, len(structure.parameters)
        self.dt, self.outputs = recordings[0].dt, recordings[0].y.shape[1]
        self.states: list[Array] = []

    def start(self, theta: Array) -> Array:
        """Return the point to start from, noise guessed from the simulation errors, initial states zero."""
        order = self.structure.build(theta).order
        self.states = [np.zeros(order) for _ in self.recordings]
        return np.concatenate([theta / self.scales, self._first_noise(theta)])

    def minimise(self, theta: Array, steps: int) -> Minimum:
        """Return the local minimum reached from these parameters."""
        start = self.start(theta)
        noise = start[self.count :]
        lower, upper = (b / self.scales for b in _bounds(self.structure))
        wide = np.full(len(noise), 12.0)  # noise may grow or shrink by e^12; below that it counts as absent
        return descend(
            self.local, start, np.concatenate([lower, noise - wide]), np.concatenate([upper, noise + wide]), steps
        )

    def split(self, z: Array) -> tuple[Array, Array]:
        """Return parameters in their units and log noise."""
        return z[: self.count] * self.scales, z[self.count :]

    def point(self, z: Array) -> PredictorPoint:
        found = predictor_point(self.structure, *self.split(z), self.dt)
        if not is_stable(found.predictor.A, self.dt):
            raise IllConditioned(f"the predictor has the pole {worst_pole(found.predictor.A, self.dt)[0]:.6g}")
        return found

    def local(self, z: Array) -> Local:
        """Return cost, gradient and Fisher information with the initial states fitted."""
        at = self.point(z)
        whitener = whitening_of(at.covariance)
        scale = np.concatenate([self.scales, np.ones(len(z) - self.count)])
        cost, gradient, information = self._noise_terms(at)
        fitted = []
        for recording, x0 in zip(self.recordings, self.states, strict=True):
            inputs = np.hstack([recording.u, recording.y])
            found = sweep(at.predictor, at.slopes, inputs, recording.y, x0, whitener)
            value, slope, curvature, x0 = eliminate_state(found, len(z), x0)
            value_xi, slope_xi = _covariance_terms(at, whitener, found.spread)
            cost, gradient, information = cost + value, gradient + slope + slope_xi, information + curvature
            fitted.append(x0)
        self._remember(cost, fitted)
        local = Local(cost, gradient * scale, information * np.outer(scale, scale))
        return self._with_prior(local, z) if self.prior else local

    def _noise_terms(self, at: PredictorPoint) -> tuple[float, Array, Array]:
        """Return what the covariance alone contributes: ``N/2 log det Xi`` and its slopes, and its Fisher
        information."""
        total = sum(map(len, self.recordings))
        relative = np.linalg.solve(at.covariance, at.covariance_slopes)
        gradient = 0.5 * total * np.trace(relative, axis1=1, axis2=2)
        information = 0.5 * total * np.einsum("aij,bji->ab", relative, relative)
        return 0.5 * total * float(np.linalg.slogdet(at.covariance)[1]), gradient, information

    def _remember(self, cost: float, fitted: list[Array]) -> None:
        if np.isfinite(cost):
            self.states = fitted

    def _with_prior(self, local: Local, z: Array) -> Local:
        sd = np.asarray([p.sd for p in self.structure.parameters]) / self.scales
        known = np.flatnonzero(sd > 0)
        gap = (z[: self.count] - self.structure.values / self.scales)[known] / sd[known]
        gradient, curvature = local.gradient.copy(), local.curvature.copy()
        gradient[known] += gap / sd[known]
        curvature[known, known] += 1 / sd[known] ** 2
        return Local(local.cost + 0.5 * float(gap @ gap), gradient, curvature)

    def _first_noise(self, theta: Array) -> Array:
        """Return log standard deviations to start from: all of the simulation error for the outputs, a tenth as
        process."""
        plant, _ = plant_point(self.structure, theta, self.dt)
        if is_stable(plant.A, self.dt):
            errors = np.vstack([fitted_errors(plant, r.u, r.y) for r in self.recordings])
        else:
            errors = np.vstack([r.y - r.y.mean(axis=0) for r in self.recordings])
        variance = np.maximum(errors.var(axis=0), 1e-300)
        E = self.structure.process_inputs
        if E is None:
            return np.asarray(0.5 * np.log(variance))
        shown = [(np.asarray(_response_power(plant.A, plant.C, column)) / variance).sum() for column in E.T]
        process = [0.5 * np.log(0.1 / max(float(s), 1e-300)) for s in shown]
        return np.concatenate([0.5 * np.log(variance), process])


def _response_power(A: Array, C: Array, column: Array, steps: int = 200) -> Array:
    """Return the power an impulse on the states leaves in every output over some samples."""
    power, state = np.zeros(len(C)), column.copy()
    for _ in range(steps):
        power += (C @ state) ** 2
        state = A @ state
        if not np.isfinite(state).all():
            break
    return power


def _covariance_terms(at: PredictorPoint, whitener: Array, spread: Array) -> tuple[float, Array]:
    inverse = whitener.T @ whitener
    moved = inverse @ at.covariance_slopes @ inverse
    return 0.0, -0.5 * np.einsum("aij,ji->a", moved, spread)


def _fit(objective: Likelihood, best: Minimum, notes: tuple[str, ...]) -> Fit:
    structure, at = objective.structure, objective.point(best.point)
    covariance = _standard_errors(objective, best)
    theta, noise = objective.split(best.point)
    sds = np.sqrt(np.diag(covariance))
    estimates = [
        ParameterEstimate(p.name, float(v), float(s), p.unit, p.value, p.sd or None)
        for p, v, s in zip(structure.parameters, theta, sds, strict=False)
    ]
    return Fit(
        "greybox",
        InnovationsForm(at.plant, at.gain, at.covariance),
        parameters=tuple(estimates),
        covariance=covariance,
        notes=(*notes, *_noise_notes(structure, noise, objective.outputs)),
    )


def _standard_errors(objective: Likelihood, best: Minimum) -> Array:
    """Return the covariance of the physical parameters; raises `BadInput` naming one that the data do not determine."""
    information, count = best.local.curvature, objective.count
    size = np.sqrt(np.clip(np.diag(information), 0.0, None))
    names = [p.name for p in objective.structure.parameters]
    for name, s in zip(names, size, strict=False):
        if not s > 1e-6:
            raise BadInput(
                f"parameter '{name}' has no influence on these recordings; leave it out of the free parameters"
            )
    # A noise intensity estimated as zero carries no information and takes none away.
    kept = np.concatenate([np.arange(count), count + np.flatnonzero(size[count:] > 1e-6)])
    relative = information[np.ix_(kept, kept)] / np.outer(size[kept], size[kept])
    values, vectors = np.linalg.eigh(relative)
    if values[0] < SETTINGS.independent_share:
        strongest = np.argsort(-np.abs(vectors[:count, 0]))[:3]
        involved = ", ".join(names[i] for i in strongest if abs(vectors[i, 0]) > 0.1)
        raise BadInput(
            f"parameters {involved} cannot be separated by these recordings; fix one of them or give prior ranges"
        )
    inverse = (vectors / values) @ vectors.T / np.outer(size[kept], size[kept])
    return np.asarray(inverse[:count, :count] * np.outer(objective.scales, objective.scales))


def greybox_band(structure: Structure, fit: Fit, omega: Array) -> ResponseBand:
    """Return the frequency response of a grey-box fit with the covariance its parameters imply (first order)."""
    theta, dt = np.asarray([e.value for e in fit.parameters]), fit.system.dt
    sds = np.asarray([e.sd for e in fit.parameters])

    def response(values: Array) -> Array:
        return np.asarray(frequency_response(plant_point(structure, values, dt)[0], omega))

    steps = np.diag(0.05 * sds)
    slopes = np.stack([(response(theta + h) - response(theta - h)) / (2 * h.sum()) for h in steps])
    parts = np.stack([slopes.real, slopes.imag], axis=-1)
    covariance = np.einsum("akpmi,ab,bkpmj->kpmij", parts, fit.covariance, parts, optimize=True)
    return ResponseBand(omega, np.asarray(response(theta)), covariance)


def _notes(minima: Sequence[Minimum], best: Minimum, failed: int) -> tuple[str, ...]:
    notes = [f"converged after {best.steps} steps" if best.converged else f"not converged after {best.steps} steps"]
    if len(minima) + failed > 1:
        same = sum(m.local.cost < best.local.cost + 1 for m in minima)
        notes.append(f"{same} of {len(minima) + failed} starting points reached the best minimum")
    return tuple(notes)


def _noise_notes(structure: Structure, noise: Array, outputs: int) -> list[str]:
    notes = [f"sd of the noise on output {i}: {np.exp(v):.4g}" for i, v in enumerate(noise[:outputs])]
    return notes + [
        f"sd of the process noise on {name}: {np.exp(v):.4g}"
        for name, v in zip(structure.process_names, noise[outputs:], strict=True)
    ]


Objective = Callable[[Array], Local]
