"""A model that is only roughly known: what its uncertain parameters send into the residual of a healthy machine.

An uncertain parameter is a fault nobody should be told of. Its wave on the excited lines is linear in its deviation
to first order, so deviations of stated standard deviation add ``sum sd_j^2 t_j t_j'`` to the covariance of the lines:
what lies along such a wave is discounted, thresholds keep their promise averaged over the models, and the deflection
lost is what the larger covariance takes away. (The thesis' section 5.5 instead adds a bias to the threshold; its
energy formula has the wrong units, the expected statistic is linear in the wave: ``N A0 A_mu cos(phase difference) /
2``.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.api.bursts import Line
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.curves import fault_curves
from afdsvc.detect.stated import uncertain_parameters
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array


def as_faults(problem: DetectionProblem) -> DetectionProblem:
    """Return the problem whose faults are the uncertain parameters."""
    if problem.uncertain is None:
        raise BadInput(f"machine '{problem.machine}' states no uncertain plant; its parameters pulled out are wanted")
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
class SampledWaves:
    """Waves ``(n, D)`` of models drawn from their uncertainty, in the healthy machine's standard deviations."""

    waves: Array

    @property
    def mean(self) -> Array:
        """Mean wave; what linearisation takes for zero."""
        return np.asarray(self.waves.mean(axis=0))

    @property
    def covariance(self) -> Array:
        """Second moment about zero, to be compared with `model_doubt`."""
        return np.asarray(self.waves.T @ self.waves / len(self.waves))


def sampled_waves(
    problem: DetectionProblem, lines: Sequence[Line], R: Array, draws: int, generator: np.random.Generator
) -> SampledWaves:
    """Return the waves of ``draws`` models whose uncertain parameters are drawn together, without linearisation."""
    deviations, curves = uncertain_parameters(problem), fault_curves(as_faults(problem), lines)
    waves = []
    for _ in range(draws):
        drawn = {name: float(sd * generator.normal()) for name, sd in deviations.items()}
        waves.append((R @ curves.together(drawn)).ravel())
    return SampledWaves(np.array(waves))
