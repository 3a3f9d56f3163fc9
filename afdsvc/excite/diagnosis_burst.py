"""The diagnosis burst: one line on every input, where the faults that resemble each other most are best separated.

With one input and one output a line brings back two numbers only, and nearly any two numbers lie near some point of some
fault's curve: that none of the known faults is there can then hardly be excluded. Such a machine gets two lines of together the
same power, far enough apart to say different things.

The pair hardest to separate is usually actuator and sensor of one axis: their waves differ by a fraction of a per
cent in the output they share and only show their difference in the other one. Frequencies are chosen for the worst
pair, the amplitude for a separation that singles out the right fault nearly always, inside what rig and noise allow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.api.bursts import Burst, Limits, Line
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.combinations import JOINED
from afdsvc.detect.features.innovations import decay
from afdsvc.detect.isolation import NONE
from afdsvc.detect.thresholds.power import required_deflection, required_separation
from afdsvc.errors import BadInput, Refused
from afdsvc.excite.amplitude_budget import Costs, Room, costs, room
from afdsvc.excite.certificate import certificate
from afdsvc.excite.expected_detection import ExpectedDetection, burst_detection
from afdsvc.excite.power_allocation import candidates
from afdsvc.excite.settings import BURST
from afdsvc.excite.simulated_burst import faulty_loop
from afdsvc.lti.statespace import Array

ALIKE = 1e-3  # share of a wave that another must leave for any burst to distinguish the two


@dataclass(frozen=True, slots=True)
class Aim:
    """What a burst is sized for: the right fault out of any two, ``severity`` large, gets ``weight`` with probability
    ``certainty``. ``suspects`` restricts it to these faults: the second burst of a two-step isolation."""

    severity: float = -0.5
    weight: float = 0.99
    certainty: float = 0.99999
    suspects: tuple[str, ...] = ()

    def goal(self, problem: DetectionProblem) -> float:
        """Return the required separation or, for a machine with a single fault, the required deflection."""
        if len(problem.fault_names) < 2:
            return required_deflection(problem.false_alarms.per_burst, self.certainty)
        return required_separation(self.weight, self.certainty)


def default_burst(
    problem: DetectionProblem,
    limits: Limits,
    seconds: float = 2.5,
    output_amplitude: float | None = None,
    aim: Aim = Aim(),  # frozen
    name: str = "diagnosis",
) -> Burst:
    """Return the burst; ``output_amplitude`` [output unit] fixes what every line may cause at the outputs it reaches
    (where one input has two lines: the root of the sum of their squares).

    Without it the amplitude is the smallest that reaches ``aim``, and never more than the limits leave after noise.
    What the burst can and cannot do is in its ``notes``. Raises `Refused` when the limits leave no room at all,
    `BadInput` for a length or amplitude that makes no sense.
    """
    if not seconds > 0 or (output_amplitude is not None and not output_amplitude > 0):
        raise BadInput(f"burst of {seconds} s and amplitude {output_amplitude}; expected positive numbers")
    left = room(problem, limits)
    if not left.output.min() > 0 or not left.input.min() > 0:
        raise Refused(f"burst '{name}': noise alone reaches the limits of machine '{problem.machine}'; a burst cannot be added")
    plan = _best_plan(problem, _frame(problem, min(seconds, limits.seconds), name), left, aim)
    share = min(1.0, aim.goal(problem) / plan.reach) if 0 < plan.reach < np.inf else 1.0
    amplitude = min(plan.largest, plan.largest * share if output_amplitude is None else output_amplitude)
    found = certificate(problem, limits, _scaled(plan.unit, amplitude), aim.severity)
    if found.factor < 1:
        amplitude, found = amplitude * found.factor, replace(found, factor=1.0)
    made = _described(problem, _scaled(plan.unit, amplitude), amplitude, aim)
    return replace(made, notes={**made.notes, "certificate": f"with any fault up to severity {aim.severity:g} {found}"})


def stated_burst(problem: DetectionProblem, limits: Limits, seconds: float, lines: Sequence[Line], severity: float = -0.5, name: str = "diagnosis") -> Burst:
    """Return a burst of these lines as they are, with ramps and settling like those of a designed one.

    Raises `Refused` with the tightest limit where the machine, healthy or with any fault up to ``severity``, would exceed one; `BadInput` for
    a frequency that cannot be sampled.
    """
    highest = np.pi / problem.plant.dt
    for line in lines:
        if not 0 < line.omega < highest:
            raise BadInput(f"burst '{name}': a line at {line.omega:g} rad/s; expected one between 0 and {highest:g} rad/s, half the sampling rate")
    burst = replace(_frame(problem, min(seconds, limits.seconds), name), lines=tuple(lines))
    found = certificate(problem, limits, burst, severity)
    if found.factor < 1:
        raise Refused(f"burst '{name}': its lines are too large: {found}")
    return replace(burst, notes={"certificate": f"with any fault up to severity {severity:g} {found}"})


def second_burst(
    problem: DetectionProblem, limits: Limits, weights: Mapping[str, float], severity: float, seconds: float = 2.5
) -> Burst:
    """Return the burst that distinguishes the two likeliest faults, given the weights a first burst left (thesis 5.5: a
    second test at a frequency chosen for the difference of the two). ``severity`` is the one estimated.

    Two faults at once are distinguished from all other faults that are in doubt. Raises `Refused` where no burst can: the same wave on every line.
    """
    suspects = sorted((n for n in weights if n != NONE), key=lambda n: -weights[n])[:2]
    if len(suspects) < 2:
        raise BadInput(f"weights of {', '.join(weights) or 'no fault'}; expected two faults to distinguish by a second burst")
    first, second = (name.split(JOINED) for name in suspects)
    aim = Aim(severity=severity, suspects=tuple(dict.fromkeys([*first, *second])))
    made = replace(default_burst(problem, limits, seconds, None, aim, "isolation"), purpose="isolate")
    if JOINED in "".join(suspects) and _alike(burst_detection(problem, made), first, second):
        raise Refused(f"no burst distinguishes {suspects[0]} from {suspects[1]}: they do the same to the loop")
    return made


def _alike(seen: ExpectedDetection, first: Sequence[str], second: Sequence[str]) -> bool:
    """Whether faults that are present together in equal severities send the wave that others may send, to first order; not where the ones are
    among the others."""
    if set(first) <= set(second) or set(second) <= set(first):
        return False
    both = [np.stack([seen.curves.slope(name, 0.0).ravel() for name in names], axis=1) for names in (first, second)]
    wave = both[0].sum(axis=1)
    rest = wave - both[1] @ np.linalg.lstsq(both[1], wave, rcond=None)[0]
    return float(np.linalg.norm(rest)) < ALIKE * float(np.linalg.norm(wave))


@dataclass(frozen=True, slots=True, eq=False)
class _Plan:
    """Unit lines, the largest factor on them inside the limits, and the separation reached with it."""

    unit: Burst
    largest: float
    reach: float


def _best_plan(problem: DetectionProblem, frame: Burst, left: Room, aim: Aim) -> _Plan:
    """Return the plan that disturbs the outputs least if it reaches the aim, else the one that uses the limits best."""
    omega = _frequencies(frame, problem)
    spent, gains, inputs = costs(problem, omega), _gains(problem, omega, aim), _inputs(problem)
    plans = []
    for price in (spent.output.max(axis=1), _share_of_room(spent, left)):
        unit = replace(frame, lines=_unit_lines(omega, spent, inputs, _choose(gains, price, omega, inputs)))
        largest = _largest(unit.lines, omega, spent, left)
        plans.append(_Plan(unit, largest, _reach(burst_detection(problem, _scaled(unit, largest)), aim)))
    goal = aim.goal(problem)
    return plans[0] if plans[0].reach >= min(goal, plans[1].reach) else plans[1]


def _reach(seen: ExpectedDetection, aim: Aim) -> float:
    """Return the smallest separation the aim is about, 0 where it is rounding, or the deflection of a single fault."""
    names = seen.curves.names
    if len(names) < 2:
        return seen.deflection(names[0], aim.severity)
    suspects = aim.suspects or names
    apart = {(a, b): seen.separation(a, aim.severity, b) for a in suspects for b in suspects if a != b}
    return min(s if s > ALIKE * seen.deflection(a, aim.severity) else 0.0 for (a, _), s in apart.items())


def _frame(problem: DetectionProblem, seconds: float, name: str) -> Burst:
    """Return the burst without lines: samples, ramps, settling.

    Raises `Refused` where more than `BURST.ringing` of a transient remains in the steady part.
    """
    samples = int(round(seconds / problem.plant.dt))
    ramp = max(int(BURST.ramp * samples), 1)
    shortest = 2 * BURST.fewest_periods + 2 * ramp
    settle = _settling(problem, samples, name) if samples > shortest else 0
    if samples < shortest + settle:
        raise BadInput(f"burst of {seconds:g} s has {samples} samples, too few for ramps, settling and {BURST.fewest_periods} periods")
    return Burst(name, problem.plant.inputs, samples, ramp, settle=settle)


def _settling(problem: DetectionProblem, samples: int, name: str) -> int:
    """Return the samples left out while the loop settles; refuses a burst most of which would measure the transient."""
    loop, dt, most = faulty_loop(problem, {}), problem.plant.dt, int(BURST.settling * samples)
    shortest = decay(loop, BURST.ringing)
    if shortest > most:
        raise Refused(
            f"burst '{name}' of {samples * dt:.3g} s: the loop rings for {shortest * dt:.3g} s, until {100 * BURST.ringing:g} % of a transient remain; "
            f"expected a burst of at least {shortest * dt / BURST.settling:.3g} s, or a controller that damps"
        )
    return min(decay(loop, BURST.settled), most)


def _frequencies(frame: Burst, problem: DetectionProblem) -> Array:
    """Return frequencies [rad/s] with whole periods in the steady part, from slow to fast, none near a rotor order.

    Unbalance and runout are waves at the orders: a line there would be projected out with them.
    """
    steady = frame.samples - 2 * frame.ramp - frame.settle
    periods = np.unique(np.round(np.geomspace(BURST.fewest_periods, BURST.highest * steady / 2, BURST.candidates)))
    orders = problem.speed * steady * problem.plant.dt / (2 * np.pi) * np.arange(1, BURST.rotor_orders + 1)
    far = np.abs(periods[:, None] - orders) > np.maximum(BURST.rotor_periods, BURST.distance * orders)
    usable = periods[far.all(axis=1)] if problem.speed > 0 else periods
    if not len(usable):
        raise BadInput(f"a burst of {frame.samples * problem.plant.dt:g} s leaves no line away from the rotor's orders; expected a longer one")
    return np.asarray(2 * np.pi * usable / (steady * problem.plant.dt))


def _share_of_room(spent: Costs, left: Room) -> Array:
    """Return the largest share of any limit that a unit line takes, shape ``(L, m)``."""
    shares = [
        np.max(spent.output / left.output[None, :, None], axis=1),
        np.max(spent.input / left.input[None, :, None], axis=1),
        np.broadcast_to(1 / np.maximum(left.alpha, 1e-300), (len(spent.output), len(left.alpha))),
    ]
    return np.asarray(np.max(shares, axis=0))


def _inputs(problem: DetectionProblem) -> list[int]:
    """Return the input of every line."""
    m, p = problem.plant.inputs, problem.plant.outputs
    return [0, 0] if m == p == 1 else list(range(m))


def _choose(pair_gains: Array, price: Array, omega: Array, inputs: Sequence[int]) -> tuple[int, ...]:
    """Return the index of the frequency for every line that separates the worst pair best at a given price ``(L, m)``.

    Squared separations of different lines add up, at least, so each input in turn is given the frequency that helps the
    pair worst off; three rounds let early choices be revised.
    """
    gains = (pair_gains / np.maximum(price, 1e-300)[:, :, None] ** 2)[:, list(inputs)]
    chosen: dict[int, int] = {}
    for _ in range(3):
        for j in range(gains.shape[1]):
            rest = [i for i in chosen if i != j]
            others = sum((gains[chosen[i], i] for i in rest), np.zeros(gains.shape[2]))
            worst = np.min(gains[:, j] + others, axis=1) + 1e-9 * gains[:, j].mean(axis=1)
            for i in rest:
                apart = BURST.same_input_distance if inputs[i] == inputs[j] else BURST.distance
                worst[np.abs(omega / omega[chosen[i]] - 1) < apart] = -np.inf
            chosen[j] = int(np.argmax(worst))
    return tuple(chosen[j] for j in sorted(chosen))


def _gains(problem: DetectionProblem, omega: Array, aim: Aim) -> Array:
    """Return the squared separation per sample of every pair that matters for a unit line, shape ``(L, m, pairs)``.

    Where no line separates any pair, or there is one fault only, squared deflections count.
    """
    found = candidates(problem, omega, aim.severity)
    seen = found.deflection.max(axis=1)
    separable = [i for i in _rows(problem, found.pairs, aim) if found.separation[i].max() > ALIKE**2 * seen[found.pairs[i][0]]]
    gains = found.separation[separable] if separable else found.deflection
    return np.asarray(np.moveaxis(gains.reshape(len(gains), len(omega), problem.plant.inputs), 0, 2))


def _rows(problem: DetectionProblem, pairs: tuple[tuple[int, int], ...], aim: Aim) -> list[int]:
    """Return the positions of the pairs the aim is about."""
    for name in aim.suspects:
        problem.augmented.channels_of(name)  # names an unknown fault
    suspects = [problem.fault_names.index(name) for name in aim.suspects] or list(range(len(problem.fault_names)))
    return [i for i, (a, b) in enumerate(pairs) if a in suspects and b in suspects]


def _unit_lines(omega: Array, spent: Costs, inputs: Sequence[int], chosen: tuple[int, ...]) -> tuple[Line, ...]:
    """Return lines that each cause an amplitude of 1 at the output they move most; those of one input together."""
    lines = []
    for j, k in zip(inputs, chosen, strict=True):
        cost = float(spent.output[k, :, j].max()) * np.sqrt(list(inputs).count(j))
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


def _scaled(burst: Burst, factor: float) -> Burst:
    return replace(burst, lines=tuple(replace(line, amplitude=line.amplitude * factor) for line in burst.lines))


def _described(problem: DetectionProblem, burst: Burst, amplitude: float, aim: Aim) -> Burst:
    """Return the burst with notes on what it does and what it cannot do."""
    seen, goal = burst_detection(problem, burst), aim.goal(problem)
    notes = {"output_amplitude": f"{amplitude:.4g}"}
    names = aim.suspects or problem.fault_names
    if len(problem.fault_names) < 2:
        close = [n for n in names if seen.deflection(n, aim.severity) < 0.999 * goal]
        return replace(burst, notes={**notes, **({"not_detected": ", ".join(close)} if close else {})})
    found = {(a, b): seen.separation(a, aim.severity, b) for a in names for b in names if a != b}
    close = [f"{a} from {b} ({s:.3g} of {goal:.3g} standard deviations)" for (a, b), s in found.items() if s < 0.999 * goal]
    if close:
        notes["not_separated"] = f"at severity {aim.severity:g}: " + ", ".join(close)
    return replace(burst, notes=notes)
