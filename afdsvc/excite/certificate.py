"""Certificate of a burst: no output, input or alpha passes its limit, whichever listed fault is present.

The whole wave is simulated, ramps and transients included, in the healthy loop and with every fault up to a severity. The loop's own noise
in the same faulty loop comes on top: the probabilities that it carries a signal over its limit, summed over the samples of the burst (Boole's
inequality, so that its correlation does not matter), are at most what `BURST.noise_peak` allows without a burst. Wave and noise grow by what the
stated uncertainty of the model's parameters can make of them, three standard deviations of all parameters together, to first order.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from afdsvc.api.bursts import Burst, Limits
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.model_uncertainty import as_faults
from afdsvc.detect.stability_range import reachable
from afdsvc.errors import BadInput, Refused
from afdsvc.excite.amplitude_budget import noise_deviations
from afdsvc.excite.settings import BURST
from afdsvc.lti.lft import star
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace

SHARES = (0.25, 0.5, 0.75, 1.0)  # of the severity up to which the burst is certified
UNCERTAIN = 3.0  # standard deviations of uncertain parameters allowed for


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
    found = _proportional(np.asarray(limits.alpha, dtype=float), alpha, [f"{excitation} {n}" for n in _names(problem.excitation_names, m)])
    wave, noise = _growth(problem, alpha)
    for fault, severities in _cases(problem, severity):
        sd = noise * _noise(problem, severities)
        left = bounds - BURST.noise_peak * sd
        if not (left > 0).all() and not fault:
            raise Refused(f"burst '{burst.name}': noise alone reaches the limit of {names[int(np.argmin(left / bounds))]}; a burst cannot be added")
        if (left > 0).all():  # else the fault breaks the limit without any burst
            found += _tightest(bounds, sd, wave * _waves(problem, severities, alpha), names, fault, min(c.factor for c in found))
    return min(found, key=lambda c: c.factor)


def _cases(problem: DetectionProblem, severity: float) -> Iterator[tuple[str, Mapping[str, float]]]:
    yield "", {}
    for name, (low, high) in reachable(problem).items():
        end = max(severity, BURST.survived * low) if severity < 0 else min(severity, BURST.survived * high)
        for share in SHARES:
            yield f"{name} at {100 * share * end:.3g} %", {name: share * end}


def _noise(problem: DetectionProblem, severities: Mapping[str, float]) -> Array:
    """Return the standard deviations of inputs and outputs ``(m + p,)``."""
    return problem.once(lambda: np.concatenate(noise_deviations(problem, severities)[::-1]), "noise", *severities.items())


def _growth(problem: DetectionProblem, alpha: Array) -> tuple[Array, Array]:
    """Return by which factors uncertain parameters enlarge the peaks of the burst and the noise, both ``(m + p,)``.

    Raises `Refused` where a parameter at `UNCERTAIN` standard deviations loses the loop.
    """
    if not problem.uncertainty:
        return np.ones(1), np.ones(1)
    uncertain, wave, noise = as_faults(problem), [], []
    for name, sd in problem.uncertainty.items():
        both = [{name: sign * UNCERTAIN * sd} for sign in (-1, 1)]
        try:
            found = [(_waves(uncertain, at, alpha).max(axis=0), _noise(uncertain, at)) for at in both]
        except BadInput as error:
            raise Refused(f"parameter '{name}' at {UNCERTAIN:g} of its standard deviations: {error}") from error
        wave.append(np.maximum(found[0][0], found[1][0]))
        noise.append(np.maximum(found[0][1], found[1][1]))
    return _enlarged(np.array(wave), _waves(problem, {}, alpha).max(axis=0)), _enlarged(np.array(noise), _noise(problem, {}))


def _enlarged(moved: Array, nominal: Array) -> Array:
    share = np.maximum(moved / np.maximum(nominal, 1e-300) - 1, 0.0)
    return np.asarray(1 + np.sqrt(np.sum(share**2, axis=0)))


def _waves(problem: DetectionProblem, severities: Mapping[str, float], alpha: Array) -> Array:
    """Return the magnitudes of inputs and outputs ``(n, m + p)``: of outputs the larger of what sensors report and what is."""
    m, p = problem.plant.inputs, problem.plant.outputs
    loop = problem.once(lambda: _watched_loop(problem, severities), "certified loop", *severities.items())
    size = np.abs(simulate(loop, alpha)[0])
    return np.hstack([size[:, :m], np.maximum(size[:, m : m + p], size[:, m + p :])])


def _watched_loop(problem: DetectionProblem, severities: Mapping[str, float]) -> StateSpace:
    """Return the loop from the excitation to inputs, reported and true outputs ``(m + 2 p,)``."""
    g, healthy = problem.augmented.close(severities), problem.plant
    n, m, p = g.order, g.inputs, g.outputs
    C, D = np.vstack([np.zeros((m, n)), g.C, healthy.C, g.C]), np.vstack([np.eye(m), g.D, healthy.D, g.D])
    return star(StateSpace(g.A, g.B, C, D, g.dt), problem.interconnection, p, m).select(slice(0, m + 2 * p), slice(None))


def _proportional(bounds: Array, waves: Array, names: list[str]) -> list[Certificate]:
    factors = bounds / np.maximum(np.abs(waves).max(axis=0), 1e-300)
    return [Certificate(float(f), name, "") for f, name in zip(factors, names, strict=True)]


def _tightest(bounds: Array, sd: Array, waves: Array, names: list[str], fault: str, least: float) -> list[Certificate]:
    """Return the certificates of the signals that allow less than ``least``."""
    found = []
    for k, peak in enumerate(np.maximum(waves.max(axis=0), 1e-300)):
        sure = (bounds[k] - BURST.noise_peak * sd[k]) / peak  # all of the noise's peak at the peak of the wave
        if sure < least:
            found.append(Certificate(float(_factor(bounds[k], sd[k], waves[:, k], sure, bounds[k] / peak)), names[k], fault))
    return found


def _factor(bound: float, sd: float, wave: Array, low: float, high: float) -> float:
    """Return the factor on a wave ``(n,)`` between ``low`` and ``high`` at which the noise passes the bound as often as `BURST.noise_peak` allows."""

    def excess(share: float) -> float:
        size = (low + share * (high - low)) * wave
        return float(np.mean(ndtr((size - bound) / sd) + ndtr(-(size + bound) / sd)) - 2 * ndtr(-BURST.noise_peak))

    if not BURST.noise_peak * sd > 1e-9 * bound or excess(0.0) >= 0:
        return low
    return high if excess(1.0) <= 0 else low + (high - low) * brentq(excess, 0.0, 1.0, xtol=1e-12)


def _names(names: tuple[str, ...], count: int) -> list[str]:
    return [f"'{names[i]}'" if i < len(names) else str(i) for i in range(count)]
