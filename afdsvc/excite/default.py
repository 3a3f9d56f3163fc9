"""The diagnosis burst: one line on every input, where the faults that resemble each other most can be told apart.

The pair hardest to separate is usually actuator and sensor of one axis: their waves differ by a fraction of a per
cent in the output they share and only show their difference in the other one. Frequencies are chosen for the worst
pair, the amplitude for a separation that singles out the right fault nearly always, inside what rig and noise allow.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from afdsvc.api.bursts import Burst, Limits, Line
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.curves import loop_response
from afdsvc.detect.demodulate import coefficients
from afdsvc.detect.power import separation_wanted
from afdsvc.detect.regressors import whitener
from afdsvc.detect.residual import decay
from afdsvc.errors import BadInput, Refused
from afdsvc.excite.budget import Costs, Room, costs, room
from afdsvc.excite.prospect import Prospect, burst_prospect
from afdsvc.excite.rehearsal import faulty_loop
from afdsvc.lti.statespace import Array

RAMP = 0.05  # share of the burst that each ramp takes
SETTLE = 0.2  # largest share left to settling
GRID = 48  # frequencies compared
PERIODS = 8  # fewest whole periods of the slowest line
FASTEST = 0.5  # highest frequency as a share of Nyquist
CLOSEST = 0.02  # smallest relative distance of two lines


@dataclass(frozen=True, slots=True)
class Aim:
    """What a burst is sized for: the right fault out of any two, ``severity`` large, gets ``weight`` with probability
    ``certainty``."""

    severity: float = -0.5
    weight: float = 0.99
    certainty: float = 0.99999


def default_burst(
    problem: DetectionProblem,
    limits: Limits,
    seconds: float = 2.5,
    output_amplitude: float | None = None,
    aim: Aim = Aim(),  # frozen
    name: str = "diagnosis",
) -> Burst:
    """Return the burst; ``output_amplitude`` [output unit] fixes what every line may cause at the outputs it reaches.

    Without it the amplitude is the smallest that reaches ``aim``, and never more than the limits leave after noise.
    What the burst can and cannot do is in its ``notes``. Raises `Refused` when the limits leave no room at all,
    `BadInput` for a length or amplitude that makes no sense.
    """
    if not seconds > 0 or (output_amplitude is not None and not output_amplitude > 0):
        raise BadInput(f"burst of {seconds} s and amplitude {output_amplitude}; positive numbers are wanted")
    frame = _frame(problem, min(seconds, limits.seconds), name)
    omega = _frequencies(frame, problem)
    spent, left = costs(problem, omega), room(problem, limits)
    if not left.output.min() > 0 or not left.input.min() > 0:
        raise Refused(f"burst '{name}': noise alone fills the limits of machine '{problem.machine}'; no room is left")
    wanted = separation_wanted(aim.weight, aim.certainty)
    gains = _pair_gains(problem, omega, aim.severity)
    best: tuple[float, float, Burst] | None = None
    for price in (spent.output.max(axis=1), _share_of_room(spent, left)):
        unit = replace(frame, lines=_unit_lines(omega, spent, _choose(gains, price, omega)))
        largest = _largest(unit.lines, omega, spent, left)
        reach = worst_separation(burst_prospect(problem, replace(unit, lines=_scaled(unit.lines, largest))), aim.severity)
        if best is None or best[0] < min(reach, wanted):
            best = (reach, largest, unit)
    assert best is not None  # noqa: S101 - the loop above ran
    reach, largest, unit = best
    smallest = largest * min(1.0, wanted / reach) if 0 < reach < np.inf else largest
    amplitude = min(largest, smallest if output_amplitude is None else output_amplitude)
    return _described(problem, replace(unit, lines=_scaled(unit.lines, amplitude)), amplitude, aim)


def _frame(problem: DetectionProblem, seconds: float, name: str) -> Burst:
    """Return the burst without lines: samples, ramps, settling."""
    samples = int(round(seconds / problem.plant.dt))
    ramp = max(int(RAMP * samples), 1)
    settle = min(decay(faulty_loop(problem, {}), 1e-3), int(SETTLE * samples))
    if samples - 2 * ramp - settle < 2 * PERIODS:
        raise BadInput(f"burst of {seconds:g} s has {samples} samples, too few for ramps, settling and {PERIODS} periods")
    return Burst(name, problem.plant.inputs, samples, ramp, settle=settle)


def _frequencies(frame: Burst, problem: DetectionProblem) -> Array:
    """Return frequencies [rad/s] with whole periods in the steady part, from slow to fast."""
    steady = frame.samples - 2 * frame.ramp - frame.settle
    periods = np.unique(np.round(np.geomspace(PERIODS, FASTEST * steady / 2, GRID)))
    return np.asarray(2 * np.pi * periods / (steady * problem.plant.dt))


def _share_of_room(spent: Costs, left: Room) -> Array:
    """Return the largest share of any limit that a unit line takes, shape ``(L, m)``."""
    shares = [
        np.max(spent.output / left.output[None, :, None], axis=1),
        np.max(spent.input / left.input[None, :, None], axis=1),
        np.broadcast_to(1 / np.maximum(left.alpha, 1e-300), (len(spent.output), len(left.alpha))),
    ]
    return np.asarray(np.max(shares, axis=0))


def _choose(pair_gains: Array, price: Array, omega: Array) -> tuple[int, ...]:
    """Return the index of the frequency for every input that separates the worst pair best at a given price ``(L, m)``.

    Squared separations of different lines add up, at least, so each input in turn is given the frequency that helps the
    pair worst off; three rounds let early choices be revised.
    """
    gains = pair_gains / np.maximum(price, 1e-300)[:, :, None] ** 2
    chosen: dict[int, int] = {}
    for _ in range(3):
        for j in range(gains.shape[1]):
            rest = [i for i in chosen if i != j]
            others = sum((gains[chosen[i], i] for i in rest), np.zeros(gains.shape[2]))
            worst = np.min(gains[:, j] + others, axis=1) + 1e-9 * gains[:, j].mean(axis=1)
            for i in rest:
                worst[np.abs(omega / omega[chosen[i]] - 1) < CLOSEST] = -np.inf
            chosen[j] = int(np.argmax(worst))
    return tuple(chosen[j] for j in sorted(chosen))


def _pair_gains(problem: DetectionProblem, omega: Array, severity: float) -> Array:
    """Return the squared separation per sample of every pair of faults for a unit line, shape ``(L, m, pairs)``.

    The nearest point of the other fault's curve is taken on its chord, which is what it is to first order.
    """
    response, Li = loop_response(problem, omega), whitener(problem.covariance)
    waves = []
    for fault in problem.fault_names:
        r = np.einsum("pq,lqm->lmp", Li, response.paths(fault, [severity]).r[0])
        waves.append(coefficients(r[:, :, None, :]).reshape(len(omega), problem.plant.inputs, -1))
    pairs = [(a, b) for a in range(len(waves)) for b in range(len(waves)) if a != b]
    if not pairs:
        return 0.5 * np.stack([np.sum(w**2, axis=-1) for w in waves], axis=-1)
    return 0.5 * np.stack([_beside(waves[a], waves[b]) for a, b in pairs], axis=-1)


def _beside(a: Array, b: Array) -> Array:
    """Return the squared length of what a has beside the direction of b."""
    along, length = np.sum(a * b, axis=-1), np.sum(b * b, axis=-1)
    return np.asarray(np.maximum(np.sum(a * a, axis=-1) - along**2 / np.maximum(length, 1e-300), 0.0))


def _unit_lines(omega: Array, spent: Costs, chosen: tuple[int, ...]) -> tuple[Line, ...]:
    """Return lines that each cause an amplitude of 1 at the output they move most."""
    lines = []
    for j, k in enumerate(chosen):
        cost = float(spent.output[k, :, j].max())
        if cost > 0:
            lines.append(Line(j, float(omega[k]), 1 / cost, phase=0.0))
    return tuple(lines)


def _largest(lines: tuple[Line, ...], omega: Array, spent: Costs, left: Room) -> float:
    """Return the largest factor on unit lines that keeps every signal inside the room."""
    output, input_, alpha = np.zeros_like(left.output), np.zeros_like(left.input), np.zeros_like(left.alpha)
    for line in lines:
        k = int(np.argmin(np.abs(omega - line.omega)))
        output += line.amplitude * spent.output[k, :, line.input]
        input_ += line.amplitude * spent.input[k, :, line.input]
        alpha[line.input] += line.amplitude
    used, have = np.concatenate([output, input_, alpha]), np.concatenate([left.output, left.input, left.alpha])
    return float(np.min(have / np.maximum(used, 1e-300))) if lines else 0.0


def worst_separation(seen: Prospect, severity: float) -> float:
    """Return the smallest separation of any fault from any other."""
    return float(seen.separations(severity).min(initial=np.inf))


def _scaled(lines: tuple[Line, ...], factor: float) -> tuple[Line, ...]:
    return tuple(replace(line, amplitude=line.amplitude * factor) for line in lines)


def _described(problem: DetectionProblem, burst: Burst, amplitude: float, aim: Aim) -> Burst:
    """Return the burst with notes on what it does and what it cannot do."""
    seen, wanted = burst_prospect(problem, burst), separation_wanted(aim.weight, aim.certainty)
    notes = {"output_amplitude": f"{amplitude:.4g}"}
    names = problem.fault_names
    table = seen.separations(aim.severity)
    close = [
        f"{names[i]} from {names[j]} ({table[i, j]:.3g} of {wanted:.3g} standard deviations)"
        for i in range(len(names))
        for j in range(len(names))
        if table[i, j] < 0.999 * wanted
    ]
    if close:
        notes["not_separated"] = f"at severity {aim.severity:g}: " + ", ".join(close)
    return replace(burst, notes=notes)
