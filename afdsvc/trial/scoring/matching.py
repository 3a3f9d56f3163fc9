"""When a name and a site given by `explain` mean what was hidden.

Only what is physically the same effect at the same place counts as equal; every such case is listed in `SAME` with its
reason. Look-alikes that data may or may not tell apart are not in the list.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from afdsvc.trial.answer import Hidden
from afdsvc.trial.effects.catalogue import CHANGE
from afdsvc.trial.machines.machine import TrialMachine

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
