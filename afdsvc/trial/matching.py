"""Whether a name means what was hidden, and how far, for the data, a wrong name is from it.

Only what is physically the same effect at the same place counts as equal; every such case is listed in `SAME` with its
reason. Look-alikes that data may or may not tell apart are not in the list: for them there is the distance d. A rival (another
name, or the same name elsewhere) is fitted, in the generator's own form and together with the plant's constants, to what the
recordings would be without noise. What is left, in units of the noise, is d: no test, given these recordings, can tell the
two apart with a probability of being right above Phi(d / 2).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from afdsvc.errors import AfdsvcError
from afdsvc.trial.answer import Hidden
from afdsvc.trial.catalogue import CHANGE, changes_at, make_effect
from afdsvc.trial.conditions import TRAIN
from afdsvc.trial.effect import Effect, Truth
from afdsvc.trial.generate import BlindTrial, scaled_to
from afdsvc.trial.machine import TrialMachine
from afdsvc.trial.oracle import Data, gauss_newton, prior, residuals, simulated
from afdsvc.trial.simulation import RunSignals
from afdsvc.trial.site import EffectSite, SignalSizes, signal_sizes

Pair = tuple[str, str]  # physics, site


@dataclass(frozen=True, slots=True)
class Same:
    """One way of saying the same: whether a name at a site means the hidden one, and why that is no look-alike."""

    reason: str
    holds: Callable[[TrialMachine, Pair, Pair], bool]


def _identical(machine: TrialMachine, hidden: Pair, named: Pair) -> bool:
    return hidden == named


def _same_axis(machine: TrialMachine, hidden: Pair, named: Pair) -> bool:
    return hidden[0] == named[0] and _axis(machine, hidden[1]) is not None and _axis(machine, hidden[1]) == _axis(machine, named[1])


def _only_axis(machine: TrialMachine, hidden: Pair, named: Pair) -> bool:
    sites = {hidden[1], named[1]}
    return (
        hidden[0] == named[0]
        and len(machine.axes) == 1
        and "machine" in sites
        and any(_axis(machine, s) is not None for s in sites)
    )


def _joint(machine: TrialMachine, hidden: Pair, named: Pair) -> bool:
    forces = {"gyroscopic_coupling", "cross_coupled_stiffness", "unbalance", "stiffness_follows_aux"}
    if hidden[0] != named[0] or hidden[1] != "machine":
        return False
    if hidden[0] in forces:
        return _axis(machine, named[1]) is not None
    return hidden[0] == "sensor_misalignment" and named[1].startswith("output:")


def _commuting(machine: TrialMachine, hidden: Pair, named: Pair) -> bool:
    if len(machine.inputs) != 1 or len(machine.outputs) != 1:
        return False
    before, after = machine.input_site(0), machine.output_site(0)
    delays = {("transport_delay", before), ("transport_delay", after)}
    lags = {("actuator_lag", before), ("sensor_lag", after)}
    return {hidden, named} <= delays or {hidden, named} <= lags


def _direct(machine: TrialMachine, hidden: Pair, named: Pair) -> bool:
    additive = {"periodic_disturbance", "constant_load"}
    if hidden[0] != named[0] or hidden[0] not in additive or len(machine.axes) != 1:
        return False
    _, B, _ = machine.matrices(machine.nominal)
    acts_at_once = B[machine.axes[0].velocity, 0] != 0
    sites = {hidden[1], named[1]}
    return bool(acts_at_once) and machine.input_site(0) in sites and any(_axis(machine, s) == 0 for s in sites)


SAME = (
    Same("the same name at the same site", _identical),
    Same("position and velocity of an axis are two names for its one balance of forces", _same_axis),
    Same("on a machine with a single axis, the machine and the axis are the same place", _only_axis),
    Same("one law with one parameter acts on both directions at once; naming one of them names the law", _joint),
    Same("with one input and one output, a delay or a lag before a linear plant is the same system as one behind it", _commuting),
    Same("where the input is itself the force on the axis, a signal added to one is added to the other", _direct),
)


def means(machine: TrialMachine, hidden: Hidden, entry: Mapping[str, Any]) -> bool:
    """Return whether an entry of ``named`` says what was hidden."""
    named = (str(entry.get("physics", "")), str(entry.get("site", "")))
    if hidden.physics == CHANGE:
        return named[0] == CHANGE and same_change(machine, (hidden.parameter, hidden.site), entry)
    return any(rule.holds(machine, (hidden.physics, hidden.site), named) for rule in SAME)


def same_place(machine: TrialMachine, hidden: Hidden, site: str) -> bool:
    """Return whether a site is where the effect was hidden, whatever its name."""
    return any(rule.holds(machine, (hidden.physics, hidden.site), (hidden.physics, site)) for rule in SAME)


def honest_pair(machine: TrialMachine, hidden: Hidden, entries: list[Mapping[str, Any]]) -> bool:
    """Return whether a lost gain is answered by the actuator and the sensor of the same axis, one the right one.

    Both act on the same element of the transfer matrix and differ only through the coupling between axes, a few per cent.
    """
    if not hidden.parameter.endswith("gain"):
        return False
    i = machine.index(hidden.site)
    gains = (("actuator gain", machine.input_site(i)), ("sensor gain", machine.output_site(i)))
    return all(any(same_change(machine, gain, e) for e in entries) for gain in gains)


def same_change(machine: TrialMachine, wanted: Pair, entry: Mapping[str, Any]) -> bool:
    """Return whether an entry names this parameter (by the keys of its parameters or its sentence) at this site.

    With one input and one output, the gain of the actuator and that of the sensor are the same factor.
    """
    parameter, site = wanted
    text = " ".join([*map(str, entry.get("parameters", {})), str(entry.get("sentence", ""))]).lower().replace("_", " ")
    given = str(entry.get("site", ""))
    if parameter.endswith("gain"):
        single = len(machine.inputs) == 1 and len(machine.outputs) == 1
        return "gain" in text and (given == site or (single and given.split(":")[0] in ("input", "output")))
    here = given == site or (_axis(machine, given) is not None and _axis(machine, given) == _axis(machine, site))
    here = here or (given == "machine" and len(machine.axes) == 1)
    return here and parameter in text


def _axis(machine: TrialMachine, site: str) -> int | None:
    """Return the axis whose position or velocity a site names, or None."""
    for number, axis in enumerate(machine.axes):
        if site in (f"state:{machine.states[axis.position].name}", f"state:{machine.states[axis.velocity].name}"):
            return number
    return None


UNDECIDABLE = 4.65  # below this d the best possible test is wrong more often than once in a hundred
SHARED = ("frequency", "phase", "damping_ratio", "delay", "time_constant")  # shapes a rival takes over from what is hidden
STARTS, STEPS = 2, 6


def rival_distance(trial: BlindTrial, entry: Mapping[str, Any]) -> float:
    """Return d between the trial's one hidden effect and the entry of ``named``; infinite when it cannot be made up here."""
    physics, site = str(entry.get("physics", "")), str(entry.get("site", ""))
    if physics == CHANGE:
        physics = next((f"{CHANGE}:{p}" for s, p in trial.machine.changes if same_change(trial.machine, (p, s), entry)), "")
        site = next((s for name, s in changes_at(trial.machine) if name == physics), site)
    best = float("inf")
    for start in range(STARTS):
        best = min(best, _fitted(trial, physics, site, start))
        if best < UNDECIDABLE:
            break
    return best


def _fitted(trial: BlindTrial, physics: str, site: str, start: int) -> float:
    size = signal_sizes(trial.machine, trial.truth, trial.runs[:TRAIN])
    try:
        rival = _scaled(trial, _shape(trial, size, physics, site, start))
    except (AfdsvcError, ValueError):
        return float("inf")
    data: Data = [
        (run, RunSignals(simulated(trial, _question(trial), run, signals), signals.u, signals.x))
        for run, signals in zip(trial.runs[:-1], trial.played[:-1], strict=True)
    ]
    best = _descend(trial, Truth(trial.truth.theta, (rival,)), data)
    return float(np.sqrt(max(best - prior(trial, _question(trial)), 0.0)))


def _question(trial: BlindTrial) -> Truth:
    return Truth(trial.truth.theta, trial.truth.effects)


def _shape(trial: BlindTrial, size: SignalSizes, physics: str, site: str, start: int) -> Effect:
    """Return the rival with shapes drawn anew but for those it shares with what is hidden.

    It may move no more parameters than what is hidden has: a law that contains another is told from it by parsimony.
    """
    machine = trial.machine
    effect = make_effect(EffectSite(machine, size, site, machine.index(site), np.random.default_rng(start)), physics)
    known = dict(zip(trial.truth.effects[0].names, trial.truth.effects[0].values, strict=True))
    shared = (known.get(name, value) if name in SHARED else value for name, value in zip(effect.names, effect.base, strict=True))
    free = effect.free[: len(trial.truth.effects[0].free)]
    return replace(effect, base=tuple(float(v) for v in shared), free=free)


def _scaled(trial: BlindTrial, effect: Effect) -> Effect:
    rho, measure = trial.answer.hidden[0].rho, trial.options.measured(trial.machine)
    return scaled_to(trial.machine, Truth(trial.truth.theta), effect, trial.runs[:TRAIN], rho, measure)


def _cost(trial: BlindTrial, truth: Truth, data: Data) -> float:
    return float(np.square(residuals(trial, truth, data)).sum()) + prior(trial, truth)


def _descend(trial: BlindTrial, truth: Truth, data: Data) -> float:
    """Return the least cost found by Gauss-Newton steps, halved while they do not help."""
    cost, damping = _cost(trial, truth, data), 1.0
    for _ in range(STEPS):
        step = gauss_newton(trial, truth, data, damping)
        new = _cost(trial, step, data)
        if not new < cost:
            damping /= 4
            continue
        done = cost - new < max(0.1, 0.03 * new) or new < 1.0
        truth, cost, damping = step, new, min(1.0, 2 * damping)
        if done:
            break
    return cost
