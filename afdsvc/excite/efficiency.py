"""Efficiency of excitation: deflection caused by a fault per disturbance of the output.

Thesis 5.4 divides the gain from alpha to the residual by that from alpha to the output, pair by pair. Over all
outputs together the squared efficiency ``r* Xi^-1 r / |N a|^2`` is the squared deflection gained per sample and per
unit of mean square output amplitude, times two; it adds up over lines, which makes the design of several lines a
linear programme.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.features.regressors import whitener
from afdsvc.detect.statistics.fault_curves import LoopResponse, loop_response
from afdsvc.detect.thresholds.power import required_deflection
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True, eq=False)
class Efficiency:
    """Efficiencies at L frequencies [rad/s] for K faults of one ``severity``.

    ``pairs (K, L, p, m)`` is the thesis' f_alpha of every pair alpha_j, r_i; ``together (K, L, m)`` counts all outputs
    and the noise covariance. Exact zeros are pairs that cannot show the fault whatever is played.
    """

    omega: Array
    severity: float
    faults: tuple[str, ...]
    pairs: Array
    together: Array

    def worst(self) -> Array:
        """Return the smallest efficiency over the faults, ``(L, m)`` (thesis 5.34 with all outputs)."""
        return np.asarray(self.together.min(axis=0))

    def best_single(self, input: int | None = None) -> tuple[float, int, float]:
        """Return frequency [rad/s], input and efficiency of the single sine that shows the worst fault best (5.35)."""
        worst = self.worst() if input is None else self.worst()[:, [input]]
        k, j = np.unravel_index(int(np.argmax(worst)), worst.shape)
        return float(self.omega[k]), int(j) if input is None else input, float(worst[k, j])


def efficiency(
    problem: DetectionProblem, omega: Sequence[float] | Array, severity: float, response: LoopResponse | None = None
) -> Efficiency:
    """Return the efficiencies of all faults at one severity."""
    loop = loop_response(problem, omega) if response is None else response
    disturbance = np.linalg.norm(loop.healthy().y[0], axis=1)  # |N e_j| over the outputs, (L, m)
    Li = whitener(problem.covariance)
    r = np.stack([loop.paths(name, [severity]).r[0] for name in problem.fault_names])
    pairs = np.abs(r) / disturbance[None, :, None, :]
    together = np.linalg.norm(Li @ r, axis=2) / disturbance[None]
    return Efficiency(np.asarray(omega, dtype=float), severity, problem.fault_names, pairs, together)


def samples_for(efficiency_: float, output_amplitude: float, false_alarm: float, detection: float) -> float:
    """Return the samples after which a sine of that efficiency and output amplitude is detected with ``detection``."""
    d = required_deflection(false_alarm, detection)
    return 2 * d**2 / (efficiency_ * output_amplitude) ** 2 if efficiency_ > 0 else float("inf")
