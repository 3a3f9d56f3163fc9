"""Physical parameters through S(theta): only the excitation alpha and the residual beta are compared.

    minimise  sum | beta - S(theta) alpha |      over theta, in the 2-norm or in the 1-norm

(A. K. Sekunda, "Fault Diagnosis and Identification of Electro-Mechanical Systems", PhD thesis, DTU 2017, section 4.2
and publication P1, Eq 15; the thesis prints the square of the 1-norm, the paper the 2-norm.) alpha is free of noise, so
feedback does no harm and no noise model is needed; with a whitening filter the 2-norm is maximum likelihood for noise
that is white in the residual, the 1-norm the same for heavy tails: a spike moves it little.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput, IllConditioned
from afdsvc.identify.fit import Fit, ParameterEstimate
from afdsvc.identify.numerics.impulse_fit import closed_slopes, differences, filtered_slopes
from afdsvc.identify.numerics.innovations_form import InnovationsForm, fitted_errors
from afdsvc.identify.numerics.prediction_errors import eliminate_state, sweep
from afdsvc.identify.parameters.noise_structure import Slopes, require_samplable
from afdsvc.identify.parameters.structure import Structure
from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.lft import star
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.stability import is_stable, worst_pole
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.yjbk import deviation_system, interconnection
from afdsvc.stats.levenberg_marquardt import Local, Minimum, descend

#: Errors smaller than this share of their standard deviation count quadratically in the 1-norm.
ROUNDED = 0.1
_OUTER_STEPS = 4


def fit_indirect(
    structure: Structure,
    fact: Factorisation,
    recordings: Sequence[InputOutputData],
    norm: int = 2,
    whitener: StateSpace | None = None,
    start: Array | None = None,
) -> Fit:
    """Return the parameters whose S(theta) explains the residuals best.

    ``recordings`` hold alpha as u and beta as y (`afdsvc.identify.methods.hansen.youla_signals` makes them), ``fact`` belongs
    to the nominal plant and the controller; ``whitener`` filters beta (see `afdsvc.lti.whitening.whitening_filter`).
    Raises `BadInput` for a norm that is neither 1 nor 2, or for parameters without influence.
    """
    if norm not in (1, 2):
        raise BadInput(f"norm {norm}; expected 1 or 2")
    objective = Mismatch(structure, fact, recordings, norm, whitener)
    theta = structure.values if start is None else start
    lower = np.asarray([p.lower for p in structure.parameters]) / structure.scales
    upper = np.asarray([p.upper for p in structure.parameters]) / structure.scales
    minimum, steps = objective.minimise(theta / structure.scales, lower, upper)
    return judged(objective, minimum, steps)


class Mismatch:
    """The misfit over ``z = theta / scale``, weighted with the covariance of the errors.

    The first ``skip`` samples are not counted; ``free`` of the last states of S (None: all of them) are fitted for every
    recording, the others start at rest.
    """

    skip: int = 0
    free: int | None = None
    tolerance: float = 1e-5  # of the log-likelihood, where the descent may end

    def __init__(
        self,
        structure: Structure,
        fact: Factorisation,
        recordings: Sequence[InputOutputData],
        norm: int,
        whitener: StateSpace | None,
    ) -> None:
        self.structure, self.fact, self.norm, self.whitener = structure, fact, norm, whitener
        self.dt, self.augmented = fact.plant.dt, interconnection(fact)
        self.recordings = [
            r if whitener is None else InputOutputData(r.u, simulate(whitener, r.y)[0], r.dt, r.name) for r in recordings
        ]
        self.covariance = np.eye(recordings[0].y.shape[1])
        self.states: list[Array] = []

    def minimise(self, z: Array, lower: Array, upper: Array) -> tuple[Minimum, int]:
        """Return the minimum from z and the steps it took; the weight is that of the errors that remain."""
        steps, best = 0, Minimum(z, Local(0.0, z, np.zeros((0, 0))), 0, False)
        for _ in range(_OUTER_STEPS):
            self.covariance = self.error_covariance(best.point * self.structure.scales)
            # In the 1-norm weights are renewed step by step, which converges slowly: stop at a thirtieth of a standard error.
            tolerance = self.tolerance if self.norm == 2 else 1e-3
            before, best = best.point, descend(self.local, best.point, lower, upper, tolerance=tolerance)
            steps += best.steps
            if float(np.abs(best.point - before).max()) < (1e-3 if self.norm == 2 else 1e-2):
                break
        return best, steps

    def signature(self, theta: Array) -> StateSpace:
        """Return S(theta), through the whitener when there is one; raises `IllConditioned` where the loop is
        unstable."""
        S = self._closed(theta)
        if not is_stable(S.A, self.dt):
            raise IllConditioned(
                f"S(theta) has the pole {worst_pole(S.A, self.dt)[0]:.6g}: the controller does not stabilise that plant"
            )
        return S

    def slopes(self, theta: Array) -> Slopes:
        """Return the slopes of the matrices of S(theta): differences of small matrices, samples do not count."""
        steps = 1e-4 * self.structure.scales
        plant = self._sampled(theta)
        moved = differences(self._sampled, theta, steps)
        if plant.D.any() or moved.D.any():
            return differences(self._closed, theta, steps)
        slopes = closed_slopes(self.augmented, plant, moved)
        return slopes if self.whitener is None else filtered_slopes(self.whitener, slopes)

    def _closed(self, theta: Array) -> StateSpace:
        sampled = self._sampled(theta)
        S = star(sampled, self.augmented, sampled.outputs, sampled.inputs)
        return S if self.whitener is None else self.whitener @ S

    def _sampled(self, theta: Array) -> StateSpace:
        plant = self.structure.build(theta)
        if plant.discrete:
            return plant
        require_samplable(plant, self.dt)
        return sample_zoh(plant, self.dt)

    def error_covariance(self, theta: Array) -> Array:
        S = self.signature(theta)
        errors = np.vstack([fitted_errors(S, r.u, r.y) for r in self.recordings])
        spread = np.median(np.abs(errors), axis=0) / 0.6745 if self.norm == 1 else None
        return np.asarray(np.diag(spread**2) if spread is not None else errors.T @ errors / len(errors))

    def local(self, z: Array) -> Local:
        theta, scale, count = z * self.structure.scales, self.structure.scales, len(z)
        S, slopes = self.signature(theta), self.slopes(theta)
        whitener = np.linalg.inv(np.linalg.cholesky(self.covariance))
        cost, gradient, curvature = 0.0, np.zeros(count), np.zeros((count, count))
        self._fit_states(S.order)
        rest = 0 if self.free is None else S.order - self.free
        for place, r in enumerate(self.recordings):
            x0, rounded = self.states[place], ROUNDED if self.norm == 1 else 0.0
            found = sweep(S, slopes, r.u, r.y, x0, whitener, rounded, skip=self.skip, free=S.order - rest)
            value, slope, bend, fitted = eliminate_state(found, count, x0[rest:])
            self.states[place] = np.concatenate([x0[:rest], fitted])
            cost, gradient, curvature = cost + value, gradient + slope, curvature + bend
        return Local(cost, gradient * scale, curvature * np.outer(scale, scale))

    def _fit_states(self, order: int) -> None:
        """Start from rest where there is no better initial state from the last evaluation."""
        if not self.states or len(self.states[0]) != order:
            self.states = [np.zeros(order) for _ in self.recordings]

    def group_gradients(self, z: Array, groups: int) -> Array:
        """Return the gradient group of samples by group of samples, ``(about groups, q)``, from the initial states fitted last."""
        theta, scale = z * self.structure.scales, self.structure.scales
        S, slopes = self.signature(theta), self.slopes(theta)
        whitener = np.linalg.inv(np.linalg.cholesky(self.covariance))
        block = max(1, -(-sum(map(len, self.recordings)) // groups))
        self._fit_states(S.order)
        parts = [
            sweep(S, slopes, r.u, r.y, x0, whitener, block=block).gradients
            for r, x0 in zip(self.recordings, self.states, strict=True)
        ]
        return np.vstack(parts)[:, : len(z)] * scale


def judged(objective: Mismatch, best: Minimum, steps: int) -> Fit:
    """Return the minimum as a fit with standard errors; raises `BadInput` for a parameter without influence."""
    structure, theta = objective.structure, best.point * objective.structure.scales
    information = _information(objective, best)
    size = np.sqrt(np.diag(information))
    for parameter, s in zip(structure.parameters, size, strict=True):
        if not s > 1e-6:
            raise BadInput(
                f"parameter '{parameter.name}' has no influence on these recordings; leave it out of the free "
                "parameters"
            )
    covariance = (
        np.linalg.inv(information / np.outer(size, size))
        / np.outer(size, size)
        * np.outer(structure.scales, structure.scales)
    )
    estimates = tuple(
        ParameterEstimate(p.name, float(v), float(np.sqrt(c)), p.unit, p.value, p.sd or None)
        for p, v, c in zip(structure.parameters, theta, np.diag(covariance), strict=True)
    )
    plant = structure.build(theta)
    plant = plant if plant.discrete else sample_zoh(plant, objective.dt)
    model = InnovationsForm(plant, np.zeros((plant.order, plant.outputs)), objective.covariance)
    notes = (f"{'converged' if best.converged else 'not converged'} after {steps} steps, {objective.norm}-norm",)
    deviation = deviation_system(objective.fact, plant)
    return Fit("indirect", model, deviation=deviation, parameters=estimates, covariance=covariance, notes=notes)


def _information(objective: Mismatch, best: Minimum) -> Array:
    """Return the information matrix; a median of Gaussian errors knows 2/pi of what their mean knows."""
    if objective.norm == 2:
        return best.local.curvature
    squared = copy(objective)
    squared.norm, squared.states = 2, []
    return np.asarray(squared.local(best.point).curvature * 2 / np.pi)
