"""What excitation costs: the largest amplitudes it may cause at outputs, actuators and alpha, whichever fault is
present.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.api.bursts import Limits
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.features.regressors import noise_sources
from afdsvc.detect.stability_range import reachable
from afdsvc.detect.statistics.fault_curves import LoopResponse, loop_response
from afdsvc.excite.settings import BURST
from afdsvc.excite.simulated_burst import noisy_loop
from afdsvc.lti.lyapunov import discrete_lyapunov
from afdsvc.lti.statespace import Array

SEVERITIES = (-0.25, -0.5, -0.75, -1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Costs:
    """Amplitudes caused by a unit line at L frequencies on each of m inputs, the worst over healthy and faulty loops:
    ``output (L, p, m)`` and ``input (L, m, m)``."""

    output: Array
    input: Array


def costs(problem: DetectionProblem, omega: Sequence[float] | Array, response: LoopResponse | None = None) -> Costs:
    """Return the costs at the frequencies [rad/s].

    Both what the sensors would report and what the nominal plant would do with the input count as output, so that a
    dead sensor hides nothing.
    """
    loop = loop_response(problem, omega) if response is None else response
    k = problem.augmented.channels
    nominal = loop.plant[:, k:, k:]
    paths = [loop.healthy(), *(loop.paths(name, _survived(problem, name)) for name in problem.fault_names)]
    y = np.concatenate([np.abs(path.y) for path in paths] + [np.abs(nominal @ path.u) for path in paths])
    u = np.concatenate([np.abs(path.u) for path in paths])
    return Costs(y.max(axis=0), u.max(axis=0))


def _survived(problem: DetectionProblem, fault: str) -> list[float]:
    """Return severities of a fault that the loop survives, up to near its loss where it does not survive all of them."""
    (low, high), (end, _) = problem.severity_range, reachable(problem)[fault]
    within = [s for s in SEVERITIES if max(low, end) <= s <= high] or [low]
    return within if end <= low else [*(s for s in within if s > BURST.survived * end), BURST.survived * end]


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """What the limits leave to excitation after the loop's own noise: ``output (p,)``, ``input (m,)``, ``alpha
    (m,)``.
    """

    output: Array
    input: Array
    alpha: Array


def room(problem: DetectionProblem, limits: Limits) -> Room:
    """Return the room below the limits; entries are 0 where the noise alone fills them."""
    y_sd, u_sd = noise_deviations(problem)
    return Room(
        np.maximum(np.asarray(limits.output, dtype=float) - BURST.noise_peak * y_sd, 0.0),
        np.maximum(np.asarray(limits.input, dtype=float) - BURST.noise_peak * u_sd, 0.0),
        np.asarray(limits.alpha, dtype=float),
    )


def noise_deviations(problem: DetectionProblem, severities: Mapping[str, float] | None = None) -> tuple[Array, Array]:
    """Return the standard deviations of measured outputs ``(p,)`` and inputs ``(m,)`` without alpha, in the healthy loop or with the
    faults present; sensor and process noise."""
    m = problem.plant.inputs
    Bn, Dn = noise_sources(problem)
    loop, q = noisy_loop(problem, severities or {}, Bn, Dn), Bn.shape[1]
    B, C, D = loop.B[:, :q], loop.C, loop.D[:, :q].copy()
    D[m : m + len(Dn)] += Dn  # what is measured contains the sensor noise itself
    P = discrete_lyapunov(loop.A, B @ B.T) if loop.order else np.zeros((0, 0))
    sd = np.sqrt(np.maximum(np.diag(C @ P @ C.T + D @ D.T), 0.0))
    return sd[m : m + len(Dn)], sd[:m]
