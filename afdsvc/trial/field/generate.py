"""Making up a field trial: recordings like those of a real machine in which laws are hidden, and the answer.

How severe hidden laws are is the share of the held-out simulation error that is theirs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.api.model import Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.errors import BadInput, Refused
from afdsvc.lti.statespace import Array
from afdsvc.trial.answer import FieldAnswer, HiddenLaw
from afdsvc.trial.effect import Effect, Truth
from afdsvc.trial.field.catalogue import FAMILIES, LAWS, FieldOptions, places
from afdsvc.trial.field.conditions import QUIET_LOOP, Conditions, conditions, stage, true_constants
from afdsvc.trial.field.rig import Rig, Sizes, Spot
from afdsvc.trial.field.simulation import OPEN, Run, Signals, modelled, play
from afdsvc.trial.laws import field as f

TOLERANCE = 0.01  # of the share
GRID = np.arange(-4.5, 7.0, 1.25)  # log severities tried from small to large
LARGEST, LEAST_MOTION = 1.1, 0.25  # error over variation; variation over that with nothing hidden
LEAST_SHARE = 0.1  # of each of several laws alone
ADDED, CANCELLED = 0.3, 1.5  # share of the effects' power in the error; power of one of several over that of all
LEAST, LEAST_LOOP, USABLE = 0.06, 0.02, 0.45  # error over variation: least with all hidden (in closed loop), largest with nothing


@dataclass(frozen=True, slots=True, eq=False)
class Measure:
    """What shares are measured by on one recording of a machine with the constants ``bare.theta``.

    ``calm`` are the outputs with nothing hidden, without noise. ``weights`` are one over the variance of each of them times their
    number; ``rest`` is the weighted mean square that the nominal model misses with nothing hidden: noise, drift, disturbances,
    errors of the constants.
    """

    rig: Rig
    bare: Truth
    run: Run
    calm: Array
    weights: Array
    rest: float

    def power(self, effects: Sequence[Effect]) -> float:
        """Return the weighted mean square of what the effects add to the outputs, without noise, under the same commands (in
        closed loop where that is how models are simulated)."""
        quiet = self.run.quiet()
        played = play(self.rig, Truth(self.bare.theta, tuple(effects)), quiet)
        same = self.rig.loop or self.run.mode == OPEN  # the model answers the same whatever is hidden
        without = self.calm if same else modelled(self.rig, Truth(self.bare.theta), quiet, played)
        added = (played.y - without)[self.run.skip :]
        return float((np.square(added).mean(axis=0) * self.weights).sum())

    def share(self, effects: Sequence[Effect]) -> float:
        """Return the share of the effects in the sum of their power and of what is missed without them."""
        power = self.power(effects) if effects else 0.0
        return power / (power + self.rest)


def measure(rig: Rig, bare: Truth, run: Run) -> Measure:
    """Return what shares are measured by on a recording with nothing hidden."""
    calm = play(rig, Truth(bare.theta), run.quiet()).y
    weights = np.asarray(1.0 / (calm[run.skip :].var(axis=0) * calm.shape[1]))
    return Measure(rig, bare, run, calm, weights, missed(rig, bare, run, weights))


def missed(rig: Rig, truth: Truth, run: Run, weights: Array) -> float:
    """Return the weighted mean square of what the nominal model misses in a recording of ``truth``, summed over the outputs."""
    played = play(rig, truth, run)
    error = (played.y - modelled(rig, Truth(rig.nominal), run, played))[run.skip :]
    return float((np.square(error).mean(axis=0) * weights).sum())


def scaled(by: Measure, effects: Sequence[Effect], wanted: float) -> tuple[Effect, ...]:
    """Return the effects at one common factor of severity that gives this share; raises `Refused` when none does."""

    def at(log: float) -> tuple[Effect, ...]:
        return tuple(e.scaled(e.severity * float(np.exp(log))) for e in effects)

    def gap(log: float) -> float:
        try:
            return by.share(at(log)) - wanted
        except Refused:
            return float("nan")

    found = _crossing(gap)
    if found is None:
        raise Refused(f"{by.rig.family}: no severity of {_sites(effects)} gives a share of {wanted:.2f}")
    return at(found)


def _crossing(gap: Callable[[float], float]) -> float | None:
    """Return the smallest log severity at which a function becomes positive, within the tolerance; None when nowhere.

    Where it is not a number the machine ran away: at small severities (a lag too short to be integrated) that is passed over.
    """
    low = -np.inf
    for log in map(float, GRID):
        value = gap(log)
        if low == -np.inf and (value > 0 or np.isnan(value)):
            continue
        if not value <= 0:
            return _bisected(gap, low, log)
        low = log
    return None


def _bisected(gap: Callable[[float], float], low: float, high: float) -> float | None:
    for _ in range(30):
        middle = 0.5 * (low + high)
        value = gap(middle)
        if abs(value) < TOLERANCE:
            return middle
        low, high = (middle, high) if value < 0 else (low, middle)
    return None


def check(by: Measure, effects: Sequence[Effect]) -> None:
    """Raise `Refused` when the machine hardly moves any more, the model's error is larger than what it describes, errors of the
    constants make up for the effects, or one of several effects is not to be seen or made up for by the others."""
    truth = by.bare.with_effects(*effects)
    y = play(by.rig, truth, by.run).y[by.run.skip :]
    motion, error = float((y.var(axis=0) * by.weights).sum()), missed(by.rig, truth, by.run, by.weights)
    power, alone = by.power(effects), [by.power([e]) for e in effects]
    if motion < LEAST_MOTION**2 or error > LARGEST**2 * max(motion, 1.0):
        raise Refused(f"{by.rig.family}: {_sites(effects)} leaves nothing of the motion")
    if error < by.rest + ADDED * power:
        raise Refused(f"{by.rig.family}: errors of the constants make up for {_sites(effects)}")
    if len(effects) > 1 and not (min(alone) > LEAST_SHARE * (min(alone) + by.rest) and max(alone) < CANCELLED * power):
        raise Refused(f"{by.rig.family}: one of {_sites(effects)} hides behind the others")


def _sites(effects: Sequence[Effect]) -> str:
    return ", ".join(e.site for e in effects)


def usable(rig: Rig, constants: Array, run: Run, wanted: float) -> Measure:
    """Return the measure for these constants, their errors halved until the nominal model describes the machine with nothing hidden.

    Raises `Refused` when noise alone makes it useless, or when it describes the machine better than models of real ones do.
    """
    least = (1.0 - wanted) * (LEAST_LOOP if rig.loop else LEAST) ** 2
    for _ in range(8):
        try:
            found = measure(rig, Truth(constants), run)
            if found.rest < least:
                break
            if found.rest < USABLE ** 2:
                return found
        except Refused:
            pass
        constants = rig.nominal + 0.5 * (constants - rig.nominal)
    raise Refused(f"{rig.family}: the nominal model is useless, or perfect")


STATED = 0.05  # relative standard deviation of what the owner does not state
FINDING = 4.0  # stated standard deviations by which a hidden change of a constant exceeds what the owner states


@dataclass(frozen=True, slots=True, eq=False)
class FieldTrial:
    """A field trial: what the solver may see (``rig`` as nominal model, ``recordings``, ``holdout``), and what it may not."""

    rig: Rig
    options: FieldOptions
    conditions: Conditions
    recordings: tuple[Trace, ...]
    holdout: Trace
    answer: FieldAnswer
    truth: Truth
    runs: tuple[Run, ...]
    played: tuple[Signals, ...]


def generate(options: FieldOptions, wanted: float, generator: np.random.Generator, seed: str = "") -> FieldTrial:
    """Return a field trial whose hidden laws make the share ``wanted`` of the nominal model's held-out error.

    The same generator state gives the same trial; ``seed`` is noted in the answer. Raises `BadInput` for a share that is none or a
    law the family has no place for, and `Refused` when no severity gives this share.
    """
    if options.laws and not 0 < wanted < 1:
        raise BadInput(f"rho {wanted:g}: in a field trial it is a share of the held-out error; expected a number between 0 and 1")
    machine, circumstances, errors, recorded, shapes = generator.spawn(5)
    rig = FAMILIES[options.family](machine)
    given = conditions(rig, not options.laws, options.repeating, circumstances)
    runs = stage(rig, given, recorded)
    by = usable(rig, true_constants(rig, given, errors), runs[-1], wanted)
    effects = _hidden(by, options, wanted, shapes)
    truth = Truth(by.bare.theta, effects, _resolution(rig, given, runs[-1]))
    _check_changes(truth, given)
    played = tuple(play(rig, truth, run) for run in runs)
    last, skip = played[-1], runs[-1].skip
    point = given.offset * _rms(last.u[skip:]), given.offset * _rms(last.y[skip:])
    traces = tuple(_trace(rig, given, truth, run, signals, point) for run, signals in zip(runs, played, strict=True))
    answer = _answer(by, given, truth, wanted, options, seed)
    return FieldTrial(rig, options, given, traces[:-1], traces[-1], answer, truth, runs, played)


def sizes(rig: Rig, truth: Truth, run: Run) -> Sizes:
    """Return the sizes of a run without noise and with nothing hidden."""
    played = play(rig, Truth(truth.theta), run.quiet())
    y, u, x = (part[run.skip :] for part in (played.y, played.u, played.x))
    speeds = [x[:, a.speed] if a.speed >= 0 else u[:, 0] for a in rig.axes]
    v = np.column_stack(speeds) if speeds else np.zeros((len(y), 0))
    return Sizes(_rms(u), _rms(y), _rms(x[:, [a.position for a in rig.axes]]), _rms(v), _rms(rig.push(truth.theta, x, u)), _rms(x))


def _rms(x: Array) -> Array:
    return np.asarray(np.sqrt(np.square(x).mean(axis=0)))


def _resolution(rig: Rig, given: Conditions, run: Run) -> tuple[Effect, ...]:
    """Return the finite resolution of every reading, if there is one."""
    if not given.resolution:
        return ()
    steps = given.resolution * _rms(play(rig, Truth(rig.nominal), run.quiet()).y) * (QUIET_LOOP if rig.controller else 1.0)
    return tuple(Effect("resolution", "output", f.COARSE, (i,), (float(q),), (0,), ("step",), ("",), ()) for i, q in enumerate(steps))


def _hidden(by: Measure, options: FieldOptions, wanted: float, shapes: np.random.Generator) -> tuple[Effect, ...]:
    """Return the hidden effects: each alone at the share, then all together."""
    if not options.laws:
        return ()
    size, effects = sizes(by.rig, by.bare, by.run), list[Effect]()
    for name, g in zip(options.laws, shapes.spawn(len(options.laws)), strict=True):
        law = LAWS[name]
        shape = law.make(Spot(by.rig, size, int(g.integers(places(by.rig, law))), g))
        effects += scaled(by, [replace(shape, physics=name)], wanted)
    together = scaled(by, effects, wanted) if len(effects) > 1 else tuple(effects)
    check(by, together)
    return together


def _check_changes(truth: Truth, given: Conditions) -> None:
    for effect in truth.effects:
        change = abs(float(effect.values[0]))
        if effect.shifts and not FINDING * (given.stated or STATED) < change < 3.0:
            raise Refused(f"a change of {change:.2f} lies within what the owner states, or beyond reason")


def _trace(rig: Rig, given: Conditions, truth: Truth, run: Run, signals: Signals, point: tuple[Array, Array]) -> Trace:
    """Return the recorded part with the fixed column roles; ``point`` are commands and readings at the operating point."""
    u, y = signals.u[run.skip :] + point[0], signals.y[run.skip :] + point[1]
    refs = rig.outputs if rig.controller is not None else ()
    followed = given.aux or any(e.code == f.FOLLOWS for e in truth.effects)
    aux = (Variable("supply", "V"),) if followed else ()
    roles = (("u", rig.inputs), ("y", rig.outputs), ("ref", refs), ("aux", aux))
    channels = tuple(Channel(f"{role}_{v.name}", v.unit) for role, variables in roles for v in variables)
    ref = run.ref[run.skip :, : len(refs)] + point[1][: len(refs)]
    return Trace(run.name, rig.dt, channels, np.hstack([u, y, ref, run.aux[run.skip :, None][:, : len(aux)]]))


def _answer(by: Measure, given: Conditions, truth: Truth, wanted: float, options: FieldOptions, seed: str) -> FieldAnswer:
    hidden = tuple(_law(e, by.share([e])) for e in truth.effects)
    together = hidden[0].share if len(hidden) == 1 else by.share(truth.effects)
    present = _present(by.rig, given, truth)
    return FieldAnswer(options.family, hidden, wanted, together, present, given.as_json(), seed, options.as_json())


def _law(effect: Effect, alone: float) -> HiddenLaw:
    law, values = LAWS[effect.physics], dict(zip(effect.names, map(float, effect.values), strict=True))
    return HiddenLaw(law.name, effect.site, alone, values, law.accept, law.partial, law.words)


def _present(rig: Rig, given: Conditions, truth: Truth) -> tuple[str, ...]:
    """Return the names of what is there besides the hidden laws."""
    beyond = np.abs(truth.theta / np.where(rig.nominal == 0, 1.0, rig.nominal) - 1.0) * (rig.loose > 0)
    there = {
        "coloured_noise": given.coloured > 0 or given.push > 0 or given.drift > 0,
        "sensor_drift": given.drift > 0,
        "sensor_offset": given.drift > 0 or given.offset > 0,
        "constant_load": given.offset > 0,
        "quantisation": given.resolution > 0,
        "parameter_change": bool(beyond.max() > 2 * (given.stated or STATED)),
    }
    return tuple(name for name, is_there in there.items() if is_there)


def make(options: FieldOptions, wanted: float, seed: Sequence[int]) -> FieldTrial:
    """Return the trial, as asked where the machine allows it.

    What no severity gives is tried on ten draws of the family, on ten more each at 0.7 and 0.5 of the share (not below 0.2), and
    then with the first law alone. Raises `Refused` when all of that fails.
    """
    name = "/".join(map(str, seed))
    for attempt in range(40):
        some = options if attempt < 30 else replace(options, laws=options.laws[:1])
        try:
            less = min(wanted, max(0.2, wanted * (1.0, 0.7, 0.5, 0.7)[attempt // 10]))
            return generate(some, less, np.random.default_rng([*seed, attempt]), f"{name}/{attempt}")
        except Refused:
            continue
    raise Refused(f"trial {name}: {', '.join(options.laws)} does not fit family {options.family}")
