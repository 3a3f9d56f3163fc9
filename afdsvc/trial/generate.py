"""Making up a trial: recordings of a machine in which something is hidden, and the answer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from afdsvc.api.model import Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.errors import Refused
from afdsvc.lti.statespace import Array
from afdsvc.trial.answer import Hidden, TrialAnswer
from afdsvc.trial.catalogue import make_effect, outside_at, physics_at, sites_of
from afdsvc.trial.conditions import TRAIN, UNITS, drawn_constants, staged_runs
from afdsvc.trial.effect import Effect, Truth
from afdsvc.trial.machine import TrialMachine
from afdsvc.trial.machines import Options
from afdsvc.trial.simulation import RunPlan, RunSignals, play_run, replay
from afdsvc.trial.site import EffectSite, SignalSizes, signal_sizes

TOLERANCE = 0.01  # relative, of rho
SPAN = (-16.0, 14.0)  # log severities tried


def effect_visibility(machine: TrialMachine, truth: Truth, runs: tuple[RunPlan, ...], measure: str) -> tuple[float, Array]:
    """Return rho of everything in ``truth.effects`` together and the effect's rms per output over that output's noise.

    rho = sqrt(sum of squared differences with and without / sum of squared sigma), over the recorded samples of the runs, with
    the very same noise. ``measure`` says what "without" means: ``commands``, the plant without the effects under the
    commands that the loop with them sent (what is left in ``y - G u``, where the evidence is); ``loop``, the closed loop
    without them, so that what feedback makes of the effect counts too.
    """
    apart = np.vstack([difference(machine, truth, run, measure) for run in runs])
    power = np.mean(np.square(apart), axis=0)
    return float(np.sqrt(power.sum() / np.square(machine.sigma).sum())), np.sqrt(power) / machine.sigma


def difference(machine: TrialMachine, truth: Truth, run: RunPlan, measure: str) -> Array:
    """Return what ``truth.effects`` add to the recorded outputs of a run, shape (n, p); see `effect_visibility`."""
    bare = truth.with_effects()
    signals = play_run(machine, truth, run)
    other = play_run(machine, bare, run) if measure == "loop" else replay(machine, bare, run, signals.u)
    return signals.kept(run).y - other.kept(run).y


def scaled_to(
    machine: TrialMachine, truth: Truth, effect: Effect, runs: tuple[RunPlan, ...], rho: float, measure: str
) -> Effect:
    """Return the effect at the severity that gives this rho > 0 on the runs; raises `Refused` when none does."""

    def gap(log_severity: float) -> float:
        candidate = truth.with_effects(effect.scaled(float(np.exp(log_severity))))
        try:
            seen, _ = effect_visibility(machine, candidate, runs, measure)
        except Refused:
            return float("inf")
        return float(np.log(max(seen, 1e-12) / rho))

    found = _root(gap)
    if found is None:
        raise Refused(f"no severity of '{effect.physics}' at '{effect.site}' gives rho {rho}; a smaller one is wanted")
    return effect.scaled(float(np.exp(found)))


def _root(gap: Callable[[float], float]) -> float | None:
    """Return where a rising function of log severity is zero within the tolerance, starting from 0; None when nowhere."""
    low, high, x = -np.inf, np.inf, 0.0
    below, above = -np.inf, np.inf
    for _ in range(40):
        value = gap(x)
        if abs(value) < TOLERANCE:
            return x
        if value < 0:
            low, below = x, value
        else:
            high, above = x, value
        if not (SPAN[0] < x < SPAN[1]) or high - low < 1e-9:
            return None
        x = _next(x, value, low, high, below, above)
    return None


def _next(x: float, value: float, low: float, high: float, below: float, above: float) -> float:
    """Return the next log severity to try: proportional steps until the root is bracketed, then inside the bracket."""
    if not (np.isfinite(low) and np.isfinite(high)):
        return x - float(np.clip(value, -2.0, 2.0))
    share = -below / (above - below) if np.isfinite(above) else 0.5
    return low + float(np.clip(share, 0.1, 0.9)) * (high - low)


DIRT, DIRT_RHO = 4, 0.04
NOTHING = "nothing"


@dataclass(frozen=True, slots=True)
class TrialRequest:
    """What to hide: canonical name (``parameter_change:stiffness`` and so on for a change), site (None: any), and rho."""

    physics: str
    site: str | None
    rho: float


@dataclass(frozen=True, slots=True, eq=False)
class BlindTrial:
    """A trial: what the solver may see (``recordings``, ``holdout``, the nominal ``machine``), and what it may not.

    ``runs`` and ``truth`` are kept for the oracle; ``played`` are the signals of the runs, their first samples included.
    """

    machine: TrialMachine
    options: Options
    recordings: tuple[Trace, ...]
    holdout: Trace
    answer: TrialAnswer
    truth: Truth
    runs: tuple[RunPlan, ...]
    played: tuple[RunSignals, ...]


def generate_trial(
    physics: str, site: str | None, rho: float, generator: np.random.Generator, options: Options | None = None
) -> BlindTrial:
    """Return a trial that hides one effect (``physics`` "nothing" or ``rho`` 0: none) at a site (None: drawn) with this rho.

    The same generator state gives the same trial. Raises `BadInput` for a name or site the machine does not have and
    `Refused` when no severity gives this rho.
    """
    nothing = physics == NOTHING or rho == 0
    return generate_several([] if nothing else [TrialRequest(physics, site, rho)], generator, options)


def generate_several(
    wishes: Sequence[TrialRequest], generator: np.random.Generator, options: Options | None = None, seed: str = ""
) -> BlindTrial:
    """Return a trial that hides several effects at once; rho is each one's alone, ``seed`` is noted in the answer.

    See `generate_trial`.
    """
    options = options or Options()
    machine = options.build()
    constants, plan, shapes, dirt = generator.spawn(4)
    runs = staged_runs(machine, options, plan)
    scene = _scene(machine, options, Truth(drawn_constants(machine, options, constants)), runs)
    if options.dirty:
        wanted = _dirt(machine, {wish.physics for wish in wishes}, dirt)
        scene = replace(scene, truth=Truth(scene.truth.theta, (), _effects(scene, wanted, dirt)))
    truth = scene.truth.with_effects(*_effects(scene, wishes, shapes))
    played = tuple(play_run(machine, truth, run) for run in runs)
    traces = tuple(_trace(machine, run, signals) for run, signals in zip(runs, played, strict=True))
    answer = _answer(replace(scene, truth=truth), options, [wish.rho for wish in wishes], seed)
    return BlindTrial(machine, options, traces[:-1], traces[-1], answer, truth, runs, played)


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """The machine before the question: its truth so far, the runs that define rho, sizes of its signals, measure of rho."""

    machine: TrialMachine
    truth: Truth
    runs: tuple[RunPlan, ...]
    sizes: SignalSizes
    measure: str


def _scene(machine: TrialMachine, options: Options, truth: Truth, runs: tuple[RunPlan, ...]) -> _Scene:
    train = runs[:TRAIN]
    return _Scene(machine, truth, train, signal_sizes(machine, truth, train), options.measured(machine))


def _effects(scene: _Scene, wishes: Sequence[TrialRequest], chance: np.random.Generator) -> tuple[Effect, ...]:
    """Return the wished effects, each scaled with the others absent."""
    return tuple(_effect(scene, w, g) for w, g in zip(wishes, chance.spawn(len(wishes)), strict=True))


def _effect(scene: _Scene, wish: TrialRequest, chance: np.random.Generator) -> Effect:
    name = wish.site or str(chance.choice(sites_of(scene.machine, wish.physics)))
    shape = make_effect(EffectSite(scene.machine, scene.sizes, name, scene.machine.index(name), chance), wish.physics)
    return scaled_to(scene.machine, scene.truth, shape, scene.runs, wish.rho, scene.measure)


def _dirt(machine: TrialMachine, taken: set[str], generator: np.random.Generator) -> list[TrialRequest]:
    """Return small unrelated effects of different names, none of those taken."""
    names = sorted({name for name, _ in physics_at(machine)} - taken)
    return [TrialRequest(str(name), None, DIRT_RHO) for name in generator.choice(names, DIRT, replace=False)]


def _trace(machine: TrialMachine, run: RunPlan, signals: RunSignals) -> Trace:
    """Return the recorded part as a trace with the fixed column roles; the rotor angle is wrapped to one turn."""
    kept, ref, s = signals.kept(run), machine.outputs if machine.recording.reference else (), run.skip
    aux = tuple(Variable(name, UNITS[name]) for name in machine.aux)
    around = run.aux[s:-1].copy()
    if machine.rotating:
        around[:, machine.aux.index("angle")] %= 2 * np.pi
    roles = (("u", machine.inputs), ("y", machine.outputs), ("alpha", machine.inputs), ("ref", ref), ("aux", aux))
    channels = tuple(Channel(f"{role}_{v.name}", v.unit) for role, variables in roles for v in variables)
    values = np.hstack([kept.u, kept.y, run.alpha[s:], run.ref[s:, : len(ref)], around])
    return Trace(run.name, machine.dt, channels, values)


def _answer(scene: _Scene, options: Options, asked: list[float], seed: str) -> TrialAnswer:
    together, seen = effect_visibility(scene.machine, scene.truth, scene.runs, scene.measure)
    outside = {name for name, _ in outside_at(scene.machine)}
    effects = scene.truth.effects
    return TrialAnswer(
        machine=options.machine,
        hidden=tuple(_hidden(scene, e, rho, together) for e, rho in zip(effects, asked, strict=True)),
        minor=tuple(_hidden(scene, e, DIRT_RHO, together) for e in scene.truth.minor),
        seen={v.name: float(s) for v, s in zip(scene.machine.outputs, seen, strict=True)},
        outside=any(e.physics in outside for e in effects),
        seed=seed,
        options=asdict(options),
    )


def _hidden(scene: _Scene, effect: Effect, asked: float, together: float) -> Hidden:
    """Return the effect as the answer keeps it; ``together`` is rho of everything hidden."""
    alone = Truth(scene.truth.theta, (effect,))
    rho = together
    if scene.truth.everything != (effect,):
        rho, _ = effect_visibility(scene.machine, alone, scene.runs, scene.measure)
    in_loop, _ = effect_visibility(scene.machine, alone, scene.runs, "loop")
    prior = _in_prior(scene.machine, effect)
    return Hidden(effect.physics, effect.site, asked, rho, in_loop, effect.described(), effect.parameter, prior)


def _in_prior(machine: TrialMachine, effect: Effect) -> float | None:
    """Return a change in units of the stated standard deviation of the constants it moves."""
    sd = max((machine.theta_sd[i] for i in effect.shifts), default=0.0)
    return float(abs(effect.values[0]) / sd) if sd > 0 else None
