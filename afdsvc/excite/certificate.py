"""Certificate of a burst: no output, input or alpha passes its limit, whichever listed fault is present.

The whole wave is simulated, ramps and transients included, in the healthy loop and with every fault up to a severity; to its peaks come
those of the loop's own noise in the same faulty loop. Everything is proportional to the burst, so what is too large says by how much.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from afdsvc.api.bursts import Burst, Limits
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.stability_range import reachable
from afdsvc.errors import Refused
from afdsvc.excite.amplitude_budget import noise_deviations
from afdsvc.excite.settings import BURST
from afdsvc.lti.lft import star
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace

SHARES = (0.25, 0.5, 0.75, 1.0)  # of the severity up to which the burst is certified
SURVIVED = 0.9  # of the severities the loop survives: closer to its loss no burst is small enough


@dataclass(frozen=True, slots=True)
class Certificate:
    """The largest factor on the burst that keeps every limit, and the limit and the fault ("" without one) that decide it."""

    factor: float
    limit: str
    fault: str

    def __str__(self) -> str:
        where = f" with {self.fault}" if self.fault else ""
        return f"{100 / self.factor:.3g} % of the room below the limit of {self.limit}{where} is used"


def certificate(problem: DetectionProblem, limits: Limits, burst: Burst, severity: float) -> Certificate:
    """Return the certificate over all listed faults up to ``severity``; raises `Refused` where noise alone reaches a limit."""
    alpha, m = burst.play(problem.plant.dt), problem.plant.inputs
    bounds = np.concatenate([limits.input, limits.output])
    names = [*(f"input {n}" for n in _names(problem.input_names, m)), *(f"output {n}" for n in _names(problem.output_names, len(limits.output)))]
    excitation = "alpha" if problem.through == "alpha" else "the reference"
    found = [_tightest(np.asarray(limits.alpha, dtype=float), np.abs(alpha).max(axis=0), [f"{excitation} {n}" for n in _names(problem.excitation_names, m)], "")]
    for fault, severities in _cases(problem, severity):
        y_sd, u_sd = noise_deviations(problem, severities)
        left = bounds - BURST.noise_peak * np.concatenate([u_sd, y_sd])
        if not (left > 0).all() and not fault:
            raise Refused(f"burst '{burst.name}': noise alone reaches the limit of {names[int(np.argmin(left / bounds))]}; a burst cannot be added")
        if (left > 0).all():  # else the fault breaks the limit without any burst
            found.append(_tightest(left, _peaks(problem, severities, alpha), names, fault))
    return min(found, key=lambda c: c.factor)


def _cases(problem: DetectionProblem, severity: float) -> Iterator[tuple[str, Mapping[str, float]]]:
    yield "", {}
    for name, (low, high) in reachable(problem).items():
        end = max(severity, SURVIVED * low) if severity < 0 else min(severity, SURVIVED * high)
        for share in SHARES:
            yield f"{name} at {100 * share * end:.3g} %", {name: share * end}


def _peaks(problem: DetectionProblem, severities: Mapping[str, float], alpha: Array) -> Array:
    """Return the peaks of inputs and outputs ``(m + p,)``: of outputs the larger of what sensors report and what is."""
    g, healthy = problem.augmented.close(severities), problem.plant
    n, m, p = g.order, g.inputs, g.outputs
    C, D = np.vstack([np.zeros((m, n)), g.C, healthy.C, g.C]), np.vstack([np.eye(m), g.D, healthy.D, g.D])
    loop = star(StateSpace(g.A, g.B, C, D, g.dt), problem.interconnection, p, m)
    peak = np.abs(simulate(loop, alpha)[0][:, : m + 2 * p]).max(axis=0)
    return np.concatenate([peak[:m], np.maximum(peak[m : m + p], peak[m + p :])])


def _tightest(left: Array, peak: Array, names: list[str], fault: str) -> Certificate:
    factor = left / np.maximum(peak, 1e-300)
    k = int(np.argmin(factor))
    return Certificate(float(factor[k]), names[k], fault)


def _names(names: tuple[str, ...], count: int) -> list[str]:
    return [f"'{names[i]}'" if i < len(names) else str(i) for i in range(count)]
