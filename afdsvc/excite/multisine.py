"""The shortest multisine that detects and isolates faults of a given size within the budget, at phases that give it a low peak.

Starting from Schroeder's phases (M. R. Schroeder, *IEEE Trans. Inf. Theory* 16, 1970) the p-norm of the waves is
minimised for growing p, which tends to the peak (P. Guillaume et al., *IEEE Trans. Instrum. Meas.* 40, 1991).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from afdsvc.api.bursts import Burst, Limits, Line
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.features.innovations import decay
from afdsvc.detect.statistics.fault_curves import loop_response
from afdsvc.detect.thresholds.power import required_deflection, required_separation
from afdsvc.errors import BadInput, Refused
from afdsvc.excite.amplitude_budget import costs, room
from afdsvc.excite.expected_detection import expected_detection
from afdsvc.excite.power_allocation import Allocation, Candidates, allocate, candidates
from afdsvc.excite.settings import BURST
from afdsvc.excite.simulated_burst import faulty_loop
from afdsvc.lti.statespace import Array, ComplexArray

FREQUENCIES = 200


@dataclass(frozen=True, slots=True)
class Wish:
    """What the burst shall do: detect faults of ``severity`` with probability ``detection`` at ``false_alarm`` per
    burst and, when ``distinguish``, single out the right one with ``weight`` and probability ``certainty``.

    ``output_amplitude`` [output unit] is that of the sine with the same mean square as all outputs together.
    """

    severity: float
    output_amplitude: float
    detection: float = 0.99
    false_alarm: float = 1e-3
    distinguish: bool = False
    weight: float = 0.99
    certainty: float = 0.999


def multisine(
    problem: DetectionProblem, limits: Limits, wish: Wish, band: tuple[float, float] | None = None, name: str = "multisine"
) -> Burst:
    """Return the burst; ``band`` [rad/s] bounds its frequencies (default: a hundredth to half of Nyquist).

    Raises `Refused` when no burst within the limits' duration can do it, saying how long it would take.
    """
    allocation = shortest(problem, wish, band)
    steady = _long_enough(problem, wish, allocation)
    dt, settle, ramp = problem.plant.dt, decay(faulty_loop(problem, {}), 1e-3), max(math.ceil(BURST.ramp * steady), 1)
    samples = steady + settle + 2 * ramp
    if samples * dt > limits.seconds:
        raise Refused(
            f"burst '{name}': {samples * dt:.3g} s are needed for faults of severity {wish.severity:g} at an output "
            f"amplitude of {wish.output_amplitude:g}; at most {limits.seconds:.3g} s are allowed"
        )
    lines = _phased(problem, limits, _whole_periods(allocation.lines, steady * dt), steady * dt)
    _fits(problem, limits, lines, name)
    return Burst(name, problem.plant.inputs, samples, ramp, lines, settle=settle)


def _long_enough(problem: DetectionProblem, wish: Wish, allocation: Allocation) -> int:
    """Return the samples with which every fault is detected as wished.

    The programme counts on one template and on the healthy machine's noise; the threshold of the whole set and the
    noise of the faulty loop ask for a little more.
    """
    samples = max(math.ceil(allocation.samples), 16)
    for _ in range(12):
        seen = expected_detection(problem, allocation.lines, samples)
        h = seen.threshold(wish.false_alarm)
        if min(seen.detection(name, wish.severity, h) for name in problem.fault_names) >= wish.detection:
            return samples
        samples = math.ceil(1.06 * samples)
    return samples


def shortest(problem: DetectionProblem, wish: Wish, band: tuple[float, float] | None = None) -> Allocation:
    """Return the split of the output budget that needs the fewest samples."""
    if not (wish.output_amplitude > 0 and wish.severity != 0):
        raise BadInput(f"output amplitude {wish.output_amplitude} and severity {wish.severity}; expected both nonzero")
    nyquist = math.pi / problem.plant.dt
    low, high = band or (nyquist / 100, nyquist / 2)
    found = candidates(problem, np.linspace(low, high, FREQUENCIES), wish.severity)
    return allocate(found, _required(found, wish), [(found.output.sum(axis=0), wish.output_amplitude**2 / 2)])


def _required(found: Candidates, wish: Wish) -> Array:
    faults = np.full(len(found.deflection), required_deflection(wish.false_alarm, wish.detection))
    apart = required_separation(wish.weight, wish.certainty) if wish.distinguish else 0.0
    return np.concatenate([faults, np.full(len(found.pairs), apart)])


def _whole_periods(lines: tuple[Line, ...], seconds: float) -> tuple[Line, ...]:
    """Return the lines on the nearest frequencies with whole periods, no two on one."""
    taken: set[int] = set()
    moved = []
    for line in sorted(lines, key=lambda line: -line.amplitude):
        nearest = max(round(line.omega * seconds / (2 * math.pi)), 1)
        periods = next(
            k for step in range(len(lines) + 1) for k in (nearest + step, nearest - step) if k > 0 and k not in taken
        )
        taken.add(periods)
        moved.append(replace(line, omega=2 * math.pi * periods / seconds))
    return tuple(sorted(moved, key=lambda line: line.omega))


def _phased(problem: DetectionProblem, limits: Limits, lines: tuple[Line, ...], seconds: float) -> tuple[Line, ...]:
    response = loop_response(problem, [line.omega for line in lines]).healthy()
    inputs = [line.input for line in lines]
    y = response.y[0, np.arange(len(lines)), :, inputs]
    u = response.u[0, np.arange(len(lines)), :, inputs]
    bounds = np.concatenate([np.asarray(limits.output, dtype=float), np.asarray(limits.input, dtype=float)])
    return low_crest(lines, np.hstack([y, u]), seconds, bounds)


def _fits(problem: DetectionProblem, limits: Limits, lines: tuple[Line, ...], name: str) -> None:
    """Raise `Refused` when the lines together may break a limit under any single fault."""
    left, spent = room(problem, limits), costs(problem, [line.omega for line in lines])
    y, u, alpha = np.zeros_like(left.output), np.zeros_like(left.input), np.zeros_like(left.alpha)
    for k, line in enumerate(lines):
        y += line.amplitude * spent.output[k, :, line.input]
        u += line.amplitude * spent.input[k, :, line.input]
        alpha[line.input] += line.amplitude
    for what, used, bound in (("output", y, left.output), ("input", u, left.input), ("alpha", alpha, left.alpha)):
        if (used > bound).any():
            i = int(np.argmax(used - bound))
            raise Refused(f"burst '{name}' may reach {used[i]:.3g} on {what} {i}; noise leaves {bound[i]:.3g} there")


POWERS = (4, 8, 16, 32)
SAMPLES = 4096


def low_crest(lines: Sequence[Line], responses: ComplexArray, seconds: float, bounds: Array) -> tuple[Line, ...]:
    """Return the lines with new phases.

    ``responses (L, s)`` lead from each line's input to the s signals whose peaks matter (outputs, actuators), ``bounds
    (s,)`` are their limits: the largest share of a limit is made small over ``seconds`` seconds.
    """
    if len(lines) < 2:
        return tuple(lines)
    waves = _waves(lines, responses / bounds, seconds)
    power = np.array([line.amplitude**2 for line in lines])
    phases = -2 * np.pi * np.cumsum(np.cumsum(power / power.sum()))
    best = min((np.zeros(len(lines)), phases), key=lambda p: peak(waves, p))
    for exponent in POWERS:
        found = minimize(_norm, best, args=(waves, exponent), jac=True, method="L-BFGS-B", options={"maxiter": 200})
        if peak(waves, found.x) < peak(waves, best):
            best = found.x
    return tuple(replace(line, phase=float(p % (2 * np.pi))) for line, p in zip(lines, best, strict=True))


def peak(waves: ComplexArray, phases: Array) -> float:
    """Return the largest value of all signals for the given phases."""
    return float(np.abs(np.imag(np.einsum("l,lst->st", np.exp(1j * phases), waves))).max())


def _waves(lines: Sequence[Line], responses: ComplexArray, seconds: float) -> ComplexArray:
    """Return complex waves ``(L, s, t)`` of every line at every signal, phases not yet applied."""
    t = np.linspace(0, seconds, SAMPLES, endpoint=False)
    turning = np.exp(1j * np.array([line.omega for line in lines])[:, None] * t[None, :])
    amplitude = np.array([line.amplitude for line in lines])
    return np.asarray(amplitude[:, None, None] * responses[:, :, None] * turning[:, None, :])


def _norm(phases: Array, waves: ComplexArray, exponent: int) -> tuple[float, Array]:
    """Return the p-norm of all samples of all signals, normalised to the peak, and its gradient."""
    turned = np.exp(1j * phases)[:, None, None] * waves
    total = np.imag(turned.sum(axis=0))
    scale = max(float(np.abs(total).max()), 1e-300)
    share = np.abs(total) / scale
    mean = float(np.mean(share**exponent))
    outer = np.sign(total) * share ** (exponent - 1)
    gradient = np.einsum("lst,st->l", np.real(turned), outer) / total.size * mean ** (1 / exponent - 1)
    return scale * mean ** (1 / exponent), np.asarray(gradient)
