"""What is proved before Q moves anything; whatever does not hold refuses, with the reason that binds.

- Every loop with the severity in the interval and the gain of Q between 0 and 1 is stable. The rectangle is covered by smaller ones; in
  each the small-gain theorem holds around its middle, so no pair of values between grid points is left out, and within a
  rectangle severity and gain may move with time as fast as they like.
- The healthy machine is stable at every gain, however it moves: Q is stable and S = 0 there.
- While the gain rises or falls, in one sample where that is smooth, noise peaks stay below the limits and standard deviations near
  those of the loops before and after; they are exact, from the time-varying Lyapunov recursion.

Sources: K. Zhou and J. C. Doyle, "Essentials of Robust Control", 1998, chapter 9 (small gain with structure); T. T. Tay, I. Mareels and
J. B. Moore, "High Performance Control", 1998, chapters 2 and 3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.api.detection import DetectionProblem
from afdsvc.api.retuning import DiagnosedFault, LoopCost, Promise, Tuning
from afdsvc.errors import Refused
from afdsvc.lti.frequency import transfer
from afdsvc.lti.lft import AugmentedPlant, star
from afdsvc.lti.norms import largest_gain, output_covariance
from afdsvc.lti.stability import describe_pole, is_stable, worst_pole
from afdsvc.lti.statespace import Array, StateSpace, solve_loop
from afdsvc.lti.yjbk import youla_parameter
from afdsvc.retune.bounds import AT_BOUND, accepted, possible_faults, sensitivities
from afdsvc.retune.cost import best_controller, deviations, signal_model, with_q
from afdsvc.retune.design import expected, severity_grid
from afdsvc.retune.settings import RETUNE, RetuneSettings

ANGLES = 128  # frequencies that choose the scaling and say early that a rectangle is too large
SCALINGS = np.geomspace(1e-3, 1e3, 25)  # of the severity's channels against the gain's
SETTLED = 1e-3  # of a transient, after which a switch is over
TRANSIENT = 0.01  # of a standard deviation whose peaks pass the limit without Q: what a switch may add to it
LONGEST_SWITCH = 200_000  # samples looked at after Q has gone to zero


@dataclass(frozen=True, slots=True)
class Proof:
    """What was proved: see `prove`.

    ``rectangles`` cover severity and gain; ``cost_before``, ``cost_after`` and ``reached`` (share of the reduction that the best controller
    of the damaged plant brings) are the worst of the interval; ``sensitivity`` of the damaged loops, of the healthy one, and the largest of those where the diagnosis is wrong (see `afdsvc.retune.bounds.possible_faults`); ``bound`` names the machine whose
    sensitivity is at its bound, or, where ``reached`` is below ``enough``, says why the best controller itself would be refused; "" where only the damage limits ``reached``; ``rise_seconds``
    and ``fall_seconds`` the shortest times in which the gain may rise and fall (0: one sample), ``bump_in`` and ``bump_out`` the largest
    standard deviations meanwhile, relative to the larger of those before and after; ``room_before`` and ``room`` the smallest share of a limit that noise peaks leave free without and with Q,
    and ``tightest`` the signal with Q.
    """

    order: int
    rectangles: int
    cost_before: float
    cost_after: float
    reached: float
    sensitivity_before: float
    sensitivity_after: float
    sensitivity_healthy: float
    sensitivity_wrong: float
    bound: str
    rise_seconds: float
    fall_seconds: float
    bump_in: float
    bump_out: float
    room_before: float
    room: float
    tightest: str


def prove(problem: DetectionProblem, found: DiagnosedFault, cost: LoopCost, Q: StateSpace, settings: RetuneSettings = RETUNE) -> Proof:
    """Return what holds for Q beside the running controller; raises `Refused` with the reason that binds.

    >>> from afdsvc.testing.machines import bearing_problem
    >>> from afdsvc.retune.cost import loop_cost
    >>> machine = bearing_problem("proportional")
    >>> Q = StateSpace.gain(0.02 * np.eye(2), machine.plant.dt)
    >>> prove(machine, DiagnosedFault("vertical_sensor", -0.4, -0.3), loop_cost(machine, {}), Q).order
    0
    """
    if not is_stable(Q.A, Q.dt):
        raise Refused(f"Q has the pole {describe_pole(worst_pole(Q.A, Q.dt)[0], Q.dt)}: if the diagnosis is wrong the healthy machine is unstable")
    rectangles = covered(problem, found, Q, settings)
    costs = expected(problem, found, cost, Q, settings.models)
    if not (costs.after < costs.before).all():
        worst = int(np.argmax(costs.after / costs.before))
        raise Refused(f"at {100 * costs.severities[worst]:.3g} % Q raises the cost from {costs.before[worst]:.4g} to {costs.after[worst]:.4g}")
    sensitive, bound = _sensitivities(problem, found, Q, settings)
    times_and_peaks, tightest = _switch(problem, found, cost, Q, settings)
    k = int(np.argmax(costs.after / costs.before))
    reached = float(np.nan_to_num(costs.reached, nan=1.0).min())
    if not bound and reached < settings.enough:
        bound = _refusal_of_best(problem, found, cost, settings)
    return Proof(Q.order, rectangles, float(costs.before[k]), float(costs.after[k]), reached, *sensitive, bound, *times_and_peaks, tightest)


def proved_tuning(
    problem: DetectionProblem, found: DiagnosedFault, cost: LoopCost, Q: StateSpace, settings: RetuneSettings = RETUNE
) -> tuple[Tuning, Proof]:
    """Return Q as a rig runs it, with the times and the promise that were proved, and the proof; raises `Refused` like `prove`.

    The promise weighs inputs and reported outputs by the variances the models predict with Q, the largest of the interval: in a machine
    as diagnosed the mean is at most ``m + p``, ``promise_slack`` times that is what Q is ended for.

    >>> from afdsvc.testing.machines import bearing_problem
    >>> from afdsvc.retune.cost import loop_cost
    >>> machine = bearing_problem("proportional")
    >>> tuning, _ = proved_tuning(machine, DiagnosedFault("vertical_sensor", -0.4, -0.3), loop_cost(machine, {}), StateSpace.gain(0.02 * np.eye(2), 2e-4))
    >>> tuning.promise.cost
    6.0
    """
    proof, m, p = prove(problem, found, cost, Q, settings), Q.outputs, Q.inputs
    models = [signal_model(problem, cost, {found.fault: s}) for s in severity_grid(problem, found, settings.models).tolist()]
    variances = np.max([np.diag(output_covariance(with_q(model, Q)))[: m + p] for model in models], axis=0)
    weights = 1 / np.maximum(variances, 1e-300)
    promise = Promise(np.diag(weights[m:]), np.diag(weights[:m]), settings.promise_slack * (m + p), settings.promise_seconds)
    return Tuning(Q, proof.rise_seconds, proof.fall_seconds, promise), proof


def covered(problem: DetectionProblem, found: DiagnosedFault, Q: StateSpace, settings: RetuneSettings = RETUNE) -> int:
    """Return how many rectangles of severity and gain prove stability over the whole interval; raises `Refused` where that fails.

    >>> from afdsvc.testing.machines import bearing_problem
    >>> machine = bearing_problem("proportional")
    >>> covered(machine, DiagnosedFault("vertical_sensor", -0.4, -0.3), StateSpace.gain(0.02 * np.eye(2), machine.plant.dt)) >= 1
    True
    """
    severity_grid(problem, found, 2)
    todo, done = [(found.low, found.high, 0.0, 1.0)], 0
    while todo:
        low, high, g0, g1 = todo.pop()
        s, g, half = (low + high) / 2, (g0 + g1) / 2, np.array([(high - low) / 2, (g1 - g0) / 2])
        loop, width = _ports(problem, found.fault, s, g, Q)
        pole, margin = worst_pole(loop.A, loop.dt)
        if not margin > 0:
            where = f"'{found.fault}' at {100 * s:.3g} % and {100 * g:.3g} % of Q"
            raise Refused(f"{where}: the loop has the pole {describe_pole(pole, loop.dt)}")
        done += 1
        if done + len(todo) > settings.rectangles:
            raise Refused(f"'{found.fault}' near {100 * s:.3g} %: stability could not be proved between grid points with {settings.rectangles} rectangles; narrow the interval")
        severity_first = _undecided(loop, width, half)
        if severity_first is None:
            continue
        if severity_first:
            todo += [(low, s, g0, g1), (s, high, g0, g1)]
        else:
            todo += [(low, high, g0, g), (low, high, g, g1)]
    return done


def _undecided(loop: StateSpace, width: int, half: Array) -> bool | None:
    """Return None where the small-gain theorem holds for all values within ``half``, else whether to halve the severity (or the gain)."""
    q = loop.outputs
    sizes = np.where(np.arange(q) < width, half[0], half[1])
    angles = np.unique(np.concatenate([np.linspace(0, np.pi, ANGLES), np.abs(np.angle(loop.poles()))]))
    response = sizes[:, None] * transfer(loop, np.exp(1j * angles))
    scales = np.where(np.arange(q)[None, :] < width, SCALINGS[:, None], 1.0)
    gains = [np.linalg.norm(d[:, None] * response / d[None, :], 2, axis=(1, 2)).max() for d in scales]
    k = int(np.argmin(gains))
    if gains[k] < 1:
        scaled = StateSpace(loop.A, loop.B / scales[k], (scales[k] * sizes)[:, None] * loop.C, (scales[k] * sizes)[:, None] * loop.D / scales[k], loop.dt)
        if largest_gain(scaled) < 1:
            return None
    alone = [np.linalg.norm(response[:, part, part], 2, axis=(1, 2)).max() for part in (slice(width), slice(width, None))]
    return bool(alone[0] >= alone[1])


def _ports(problem: DetectionProblem, fault: str, severity: float, gain: float, Q: StateSpace) -> tuple[StateSpace, int]:
    """Return the loop around (severity, gain) seen by deviations of both, ``[w, v] -> [z, q]``, and the width of w.

    ``w`` adds to ``severity z`` and ``v`` to ``gain q`` with ``q = Q beta``: ``w = d_severity z``, ``v = d_gain q`` closes every other loop.
    """
    shifted, width = _shifted(problem.augmented.reordered([fault]), severity)
    m, p = Q.outputs, Q.inputs
    tapped = StateSpace(
        Q.A, np.hstack([Q.B, np.zeros((Q.order, m))]), np.vstack([gain * Q.C, Q.C]),
        np.block([[gain * Q.D, np.eye(m)], [Q.D, np.zeros((m, m))]]), Q.dt,
    )  # fmt: skip
    return star(shifted, star(problem.interconnection, tapped, p, m), p, m), width


def _shifted(augmented: AugmentedPlant, severity: float) -> tuple[StateSpace, int]:
    """Return the plant from ``[w, u]`` to ``[z, y]`` with the severity in place, w beside it, and the width of w."""
    s, k = augmented.system, augmented.channels
    inner = solve_loop(np.eye(k) - severity * s.D[:k, :k])  # z = inner (Cz x + Dzw w + Dzu u)
    Cz, Dz = inner @ s.C[:k], inner @ s.D[:k]
    into = np.vstack([s.B[:, :k], s.D[:, :k]])
    A = s.A + severity * into[: s.order] @ Cz
    B = s.B + severity * into[: s.order] @ Dz
    C = np.vstack([Cz, s.C[k:] + severity * s.D[k:, :k] @ Cz])
    D = np.vstack([Dz, s.D[k:] + severity * s.D[k:, :k] @ Dz])
    return StateSpace(A, B, C, D, s.dt), k


def _sensitivities(problem: DetectionProblem, found: DiagnosedFault, Q: StateSpace, settings: RetuneSettings) -> tuple[tuple[float, float, float, float], str]:
    """Return the largest sensitivity of the damaged loops without and with Q, of the healthy one, of those where the diagnosis is wrong, and the one
    at its bound; may refuse."""
    cases, peaks = possible_faults(problem, found), sensitivities(problem, found, Q)
    most = accepted(problem, found, peaks[:, 0], settings)
    k = int(np.argmax(peaks[:, 1] / most))
    machine = ", ".join(f"'{name}' at {100 * s:.3g} %" for name, s in cases[k].items()) or "no fault at all"
    if peaks[k, 1] > most[k]:
        raise Refused(f"the sensitivity with {machine} would be {peaks[k, 1]:.3g}; at most {most[k]:.3g} is accepted")
    bound = f"the sensitivity with {machine} is at its bound of {most[k]:.3g}" if peaks[k, 1] > AT_BOUND * most[k] and peaks[k, 1] > peaks[k, 0] else ""
    wrong = np.array([found.fault not in case for case in cases])
    before, after = peaks[~wrong].max(axis=0)
    return (float(before), float(after), float(peaks[cases.index({}), 1]), float(peaks[wrong, 1].max())), bound


def _refusal_of_best(problem: DetectionProblem, found: DiagnosedFault, cost: LoopCost, settings: RetuneSettings) -> str:
    """Return why the best controller of the damaged machine would be refused, "" where it would not: what keeps Q from it."""
    best = best_controller(problem, cost, {found.fault: found.middle})
    try:
        prove(problem, DiagnosedFault(found.fault, found.middle, found.middle), cost, youla_parameter(problem.interconnection, best), settings)
    except Refused as why:
        return f"the best controller itself would be refused: {why}"
    return ""


def _switch(
    problem: DetectionProblem, found: DiagnosedFault, cost: LoopCost, Q: StateSpace, settings: RetuneSettings
) -> tuple[tuple[float, float, float, float, float, float], str]:
    """Return times and bumps of coming and going, and the smallest room before and with Q with its signal; refuses where no change is smooth."""
    switch = Switch.of(judged_models(problem, found, cost, settings.models), Q, problem.plant.inputs, problem.plant.outputs)
    rise, bump_in = _shortest(problem, switch, switch.rise, settings, "comes")
    fall, bump_out = _shortest(problem, switch, switch.fall, settings, "goes")
    room_before, _ = _room(problem, switch, switch.before, settings)
    room, name = _room(problem, switch, switch.larger, settings)
    return (rise, fall, bump_in, bump_out, room_before, room), name


def judged_models(problem: DetectionProblem, found: DiagnosedFault, cost: LoopCost, count: int) -> list[StateSpace]:
    """Return the loops in which switches are judged: ``count`` severities of the interval, and the `possible_faults` of a wrong diagnosis."""
    diagnosed = [{found.fault: s} for s in severity_grid(problem, found, count).tolist()]
    wrong = [case for case in possible_faults(problem, found) if found.fault not in case]
    return [signal_model(problem, cost, case) for case in (*diagnosed, *wrong)]


def _shortest(
    problem: DetectionProblem, switch: Switch, passed: Callable[[int], Array], settings: RetuneSettings, word: str
) -> tuple[float, float]:
    """Return the shortest time [s] of a smooth change within all limits, 0 for one sample, and the bump of it; may refuse."""
    dt = switch.Q.dt
    times = [t for t in settings.switch_seconds if t == 0 or round(t / dt) > 1]
    for seconds in times:
        peaks = passed(max(round(seconds / dt), 1))
        bump, (room, name) = float((peaks / switch.larger).max()), _room(problem, switch, peaks, settings)
        if bump <= settings.bump and room >= 0:
            return seconds, bump
    if room < 0:
        raise Refused(f"while Q {word} over {seconds:g} s noise peaks would pass the limit of {name} by {-100 * room:.3g} %")
    raise Refused(
        f"while Q {word} over {seconds:g} s a signal's standard deviation is {bump:.3g} times that of the loops before and after; "
        f"at most {settings.bump:g} is accepted"
    )


def _room(problem: DetectionProblem, switch: Switch, peaks: Array, settings: RetuneSettings) -> tuple[float, str]:
    """Return the smallest free share of a limit and its signal; a limit that noise passes without Q is that noise's."""
    limits, m, p = problem.limits, problem.plant.inputs, problem.plant.outputs
    if limits is None:
        return 1.0, "none stated"
    limit = np.concatenate([limits.input, limits.output])
    bound = np.maximum(limit, settings.noise_peak * switch.before)
    free = 1 - settings.noise_peak * peaks / bound
    free = np.where((bound > limit) & (np.abs(free) < TRANSIENT), 0.0, free)
    k = int(np.argmin(free.min(axis=0)))
    names = [*(problem.input_names or range(m)), *(problem.output_names or range(p))]
    return float(free.min()), f"{'input' if k < m else 'output'} '{names[k]}'"


@dataclass(frozen=True, slots=True, eq=False)
class Switch:
    """Loops that Q enters and leaves: stacked matrices and standard deviations ``(k, m + p)`` ``before`` and ``after``."""

    models: Sequence[StateSpace]
    Q: StateSpace
    m: int
    p: int
    before: Array
    after: Array

    @classmethod
    def of(cls, models: Sequence[StateSpace], Q: StateSpace, m: int, p: int) -> Switch:
        """Return the switch of Q in ``models`` (see `afdsvc.retune.cost.signal_model`)."""
        before, after = (np.array([deviations(with_q(model, Q, g), m, p) for model in models]) for g in (0.0, 1.0))
        return cls(models, Q, m, p, before, after)

    @property
    def larger(self) -> Array:
        """The larger of both standard deviations, signal by signal."""
        return np.maximum(self.before, self.after)

    def rise(self, samples: int) -> Array:
        """Return the largest standard deviations ``(k, m + p)`` while the gain rises over ``samples`` and until the transient has passed."""
        return self._largest([self._steady(model, 0.0) for model in self.models], gain_ramp(samples), self._settling(1.0))

    def fall(self, samples: int) -> Array:
        """Return the same while the gain falls to zero over ``samples``; one is a cut."""
        return self._largest([self._steady(model, 1.0) for model in self.models], 1 - gain_ramp(samples), self._settling(0.0))

    def _settling(self, gain: float) -> int:
        """Return the samples after which a transient of these loops has passed."""
        slowest = max(1 - worst_pole(with_q(model, self.Q, gain).A, self.Q.dt)[1] for model in self.models)
        return min(int(np.log(SETTLED) / np.log(min(slowest, 1 - 1e-6))) + 10, LONGEST_SWITCH)

    def _steady(self, model: StateSpace, gain: float) -> Array:
        """Return the covariance of all states, those of Q at rest where they do not act."""
        loop, n, q = with_q(model, self.Q, gain), model.order, self.Q.order
        seen = StateSpace(loop.A, loop.B, np.eye(n + q), np.zeros((n + q, loop.inputs)), loop.dt)
        P = output_covariance(seen)
        if gain == 0:
            P[n:, :], P[:, n:] = 0.0, 0.0
        return P

    def _largest(self, start: Sequence[Array], ramp: Array, settling: int) -> Array:
        P, found = np.stack(start), np.zeros((len(self.models), self.m + self.p))
        (A0, B0, C0, D0), (A1, B1, C1, D1) = (self._stacked(g) for g in (0.0, 1.0))  # affine in the gain: alpha does not reach beta at once
        m, p = self.m, self.p
        for gain in [*ramp.tolist(), *[float(ramp[-1])] * settling]:
            A, B, C, D = A0 + gain * (A1 - A0), B0 + gain * (B1 - B0), C0 + gain * (C1 - C0), D0 + gain * (D1 - D0)
            variances = ((C @ P) * C).sum(axis=2) + np.square(D).sum(axis=2)
            sd = np.sqrt(np.maximum(variances, 0.0))
            found = np.maximum(found, np.hstack([sd[:, :m], np.maximum(sd[:, m : m + p], sd[:, m + p : m + 2 * p])]))
            P = A @ P @ np.swapaxes(A, 1, 2) + B @ np.swapaxes(B, 1, 2)
        return found

    def _stacked(self, gain: float) -> tuple[Array, Array, Array, Array]:
        loops = [with_q(model, self.Q, gain) for model in self.models]
        return np.stack([s.A for s in loops]), np.stack([s.B for s in loops]), np.stack([s.C for s in loops]), np.stack([s.D for s in loops])


def gain_ramp(samples: int) -> Array:
    """Return the gain of Q over its ramp ``(samples,)``: a raised cosine from above 0 to 1, with zero slope at both ends.

    >>> gain_ramp(4).round(3).tolist()
    [0.146, 0.5, 0.854, 1.0]
    """
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * (np.arange(samples) + 1) / samples), dtype=np.float64)
