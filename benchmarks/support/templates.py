"""The waves a burst would send into the residual under each fault, sample by sample, transients included."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.features.regressors import whitener
from afdsvc.errors import BadInput
from afdsvc.lti.lft import star
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace


def residual_path(problem: DetectionProblem, severities: Mapping[str, float]) -> StateSpace:
    """Return the system from alpha to the normalised residual with the faults present.

    The faulty plant is closed with J_K; then ``r = F [y; u]`` with the innovations filter F.
    """
    g = problem.augmented.close(severities)
    n, m, p = g.order, g.inputs, g.outputs
    C, D = np.vstack([g.C, np.zeros((m, n)), g.C]), np.vstack([g.D, np.eye(m), g.D])
    loop = star(StateSpace(g.A, g.B, C, D, g.dt), problem.interconnection, p, m)
    signals = loop.select(slice(0, p + m), slice(0, m))
    return StateSpace.gain(whitener(problem.covariance), g.dt) @ problem.innovations @ signals


@dataclass(frozen=True, slots=True, eq=False)
class Templates:
    """Normalised waves ``(n, K, p)`` of K faults at the given ``severities (K,)``."""

    waves: Array
    severities: Array

    @property
    def gram(self) -> Array:
        """Inner products of the waves, shape ``(K, K)``; the diagonal holds squared deflections."""
        flat = np.moveaxis(self.waves, 1, 0).reshape(self.waves.shape[1], -1)
        return np.asarray(flat @ flat.T)


def _wave(problem: DetectionProblem, fault: str, severity: float, alpha: Array) -> Array:
    path = residual_path(problem, {fault: severity})
    if not path.is_stable():
        raise BadInput(f"fault '{fault}' of severity {severity:g} makes the loop unstable; expected a severity it survives")
    return simulate(path, alpha)[0]


def templates(problem: DetectionProblem, alpha: Array, severities: Array) -> Templates:
    """Return what the excitation ``alpha (n, m)`` sends into the residual under each fault by itself.

    Raises `BadInput` for a severity the loop does not survive: no wave comes back from it.
    """
    waves = [_wave(problem, name, float(th), alpha) for name, th in zip(problem.fault_names, severities, strict=True)]
    return Templates(np.stack(waves, axis=1), np.asarray(severities, dtype=float))
