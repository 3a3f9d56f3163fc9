"""A model that is only roughly known: what its uncertain parameters send into the residual of a healthy machine.

An uncertain parameter acts like a fault that must not be reported. Its wave on the excited lines is linear in its deviation
to first order, so deviations of stated standard deviation add ``sum sd_j^2 t_j t_j'`` to the covariance of the lines:
what lies along such a wave is discounted, thresholds keep their promise averaged over the models, and the deflection
lost is what the larger covariance takes away. (The thesis' section 5.5 instead adds a bias to the threshold; its
energy formula has the wrong units, the expected statistic is linear in the wave: ``N A0 A_mu cos(phase difference) /
2``.)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from afdsvc.api.bursts import Line
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.statistics.fault_curves import fault_curves
from afdsvc.detect.thresholds import maximum
from afdsvc.detect.thresholds.maximum import Mixture
from afdsvc.detect.uncertain_parameters import uncertain_parameters
from afdsvc.errors import BadInput
from afdsvc.lti.lft import fault_signature
from afdsvc.lti.stability import worst_pole
from afdsvc.lti.statespace import Array

NODES = 15  # models of one uncertain parameter
POINTS = 256  # models of several
WIDER = 2.5  # variance added to that of the parameters when several are drawn, over their number


def as_faults(problem: DetectionProblem) -> DetectionProblem:
    """Return the problem whose faults are the uncertain parameters."""
    if problem.uncertain is None:
        raise BadInput(f"machine '{problem.machine}' states no uncertain plant; expected its parameters pulled out")
    return replace(problem, augmented=problem.uncertain, uncertain=None, uncertainty={}, severity_range=(-1.0, 1.0))


def model_waves(problem: DetectionProblem, lines: Sequence[Line], R: Array) -> Array:
    """Return the waves of one standard deviation of every uncertain parameter, shape ``(J, D)``, by linearisation."""
    deviations = uncertain_parameters(problem)
    if not deviations:
        return np.zeros((0, R.shape[0] * problem.plant.outputs))
    curves = fault_curves(as_faults(problem), lines)
    return np.stack([sd * (R @ curves.slope(name, 0.0)).ravel() for name, sd in deviations.items()])


def model_doubt(problem: DetectionProblem, lines: Sequence[Line], R: Array) -> Array:
    """Return what the uncertain model adds to the covariance of the lines, shape ``(D, D)``."""
    waves = model_waves(problem, lines, R)
    return np.asarray(waves.T @ waves)


@dataclass(frozen=True, slots=True, eq=False)
class HealthyMachines:
    """Healthy machines as they may be: ``weights (Q,)``, their waves ``(Q, D)`` and noise covariances ``(Q, D, D)``
    in the nominal machine's standard deviations, without linearisation. A wrong model also colours the loop's own
    noise.
    """

    weights: Array
    waves: Array
    covariances: Array

    @property
    def spread(self) -> Array:
        """Second moment of the waves about zero, ``(D, D)``; to first order that is `model_doubt`."""
        return np.asarray(np.einsum("q,qi,qj->ij", self.weights, self.waves, self.waves))

    def mixture(self, directions: Array) -> Mixture:
        """Return these machines seen along directions ``(K, D)``."""
        return Mixture(self.weights, self.waves, np.asarray(np.linalg.cholesky(self.covariances)), directions)


def models(problem: DetectionProblem, lines: Sequence[Line], R: Array) -> HealthyMachines:
    """Return the machines the uncertainty allows: quadrature nodes for one parameter, a low-discrepancy set for more."""
    return problem.once(lambda: _models(problem, lines, R), "models", tuple(lines), np.ascontiguousarray(R).tobytes())


def _models(problem: DetectionProblem, lines: Sequence[Line], R: Array) -> HealthyMachines:
    deviations, D = uncertain_parameters(problem), R.shape[0] * problem.plant.outputs
    if not deviations:
        return HealthyMachines(np.ones(1), np.zeros((1, D)), np.eye(D)[None])
    z, weights = _nodes(len(deviations))
    curves = fault_curves(as_faults(problem), lines)
    found = [curves.together({n: float(sd * zj) for (n, sd), zj in zip(deviations.items(), row, strict=True)}) for row in z]
    waves = np.array([(R @ point).ravel() for point, _ in found])
    return HealthyMachines(weights, waves, np.array([covariance for _, covariance in found]))


def share_near_instability(problem: DetectionProblem) -> float:
    """Return the share of the machines that the uncertainty allows whose loop is lost or keeps less than half of the model's stability margin."""
    deviations = uncertain_parameters(problem)
    if not deviations or problem.uncertain is None:
        return 0.0
    uncertain, (z, weights) = problem.uncertain, _nodes(len(deviations))

    def margin(at: Mapping[str, float]) -> float:
        loop = fault_signature(uncertain, problem.interconnection, at)
        return worst_pole(loop.A, loop.dt)[1]

    found = [margin({n: float(sd * x) for (n, sd), x in zip(deviations.items(), row, strict=True)}) for row in z]
    return float(weights[np.array(found) < margin({}) / 2].sum())


def threshold_over_models(directions: Array, found: HealthyMachines, false_alarm: float) -> float:
    """Return h at which ``max_k <e_k, z>`` exceeds h with probability ``false_alarm`` averaged over the models.

    ``directions (K, D)`` need not be unit vectors: ``<e_k, z>`` has unit variance in the nominal machine plus doubt.
    """
    e = np.ascontiguousarray(directions, dtype=float)
    nominal = maximum.maximum_threshold(e, false_alarm)
    if len(found.weights) == 1:
        return nominal
    return found.mixture(e).threshold(lambda h: np.full(len(e), h), false_alarm, nominal)


def _nodes(parameters: int) -> tuple[Array, Array]:
    """Return standard normal nodes ``(Q, J)`` and their weights."""
    if parameters == 1:
        z, w = np.polynomial.hermite_e.hermegauss(NODES)
        return z[:, None], w / w.sum()
    # rare alarms come from models far out: the points are spread wider than the parameters, less so in many dimensions, and weighted
    wide = 1 + WIDER / parameters
    u = qmc.Sobol(parameters, scramble=False).random(POINTS)
    shifted = np.modf(u + (1 + np.arange(parameters)) * 0.6180339887498949)[0]
    z = math.sqrt(wide) * ndtri(np.clip(shifted, 1e-9, 1 - 1e-9))
    w = np.exp(-0.5 * np.sum(z**2, axis=1) * (1 - 1 / wide))
    return np.asarray(z), w / w.sum()
