"""Everything that can be hidden: canonical name, the places where it makes sense, and how it is made up there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from afdsvc.errors import BadInput
from afdsvc.trial import kinds as f
from afdsvc.trial import kinds as i
from afdsvc.trial import kinds as o
from afdsvc.trial.effect import Effect
from afdsvc.trial.laws import scalar as c
from afdsvc.trial.machine import TrialMachine
from afdsvc.trial.site import EffectSite

CHANGE = "parameter_change"


@dataclass(frozen=True, slots=True)
class Kind:
    """A canonical name at one sort of place (input, axis, output or machine).

    ``needs`` says what the machine must have: ``rotor``, ``pair`` (two outputs), ``pressure``, ``spring`` (a stiffness that
    ties the machine to its place: without one a shifted zero of the sensor leaves no trace in closed loop). ``known`` is False
    for physics that is not in the vocabulary.
    """

    physics: str
    place: str
    make: Callable[[EffectSite], Effect]
    needs: tuple[str, ...] = ()
    known: bool = True


_KNOWN = (
    Kind("transport_delay", "input", i.input_delay),
    Kind("actuator_lag", "input", i.actuator_lag),
    Kind("resonant_actuator", "input", i.resonant_actuator),
    Kind("dead_zone", "input", i.input_dead_zone),
    Kind("saturation", "input", i.input_saturation),
    Kind("backlash", "input", i.input_backlash),
    Kind("hysteresis", "input", i.input_hysteresis),
    Kind("creep", "input", i.input_creep),
    Kind("slew_limit", "input", i.slew_limit),
    Kind("static_nonlinearity", "input", i.static_nonlinearity),
    Kind("gain_follows_aux", "input", i.input_gain_follows_aux),
    Kind("periodic_disturbance", "input", i.input_tone),
    Kind("coulomb_friction", "axis", f.coulomb_friction),
    Kind("stribeck_friction", "axis", f.stribeck_friction),
    Kind("quadratic_damping", "axis", f.axis_quadratic_damping),
    Kind("cubic_stiffness", "axis", f.cubic_stiffness),
    Kind("quadratic_stiffness", "axis", f.quadratic_stiffness),
    Kind("clearance", "axis", f.clearance),
    Kind("flexible_mode", "axis", f.axis_flexible_mode),
    Kind("hysteresis", "axis", f.axis_hysteresis),
    Kind("constant_load", "axis", f.constant_load),
    Kind("periodic_disturbance", "axis", f.axis_tone),
    Kind("gyroscopic_coupling", "machine", f.gyroscopic_coupling, ("rotor", "pair")),
    Kind("cross_coupled_stiffness", "machine", f.cross_coupled_stiffness, ("rotor", "pair")),
    Kind("unbalance", "machine", f.rotor_unbalance, ("rotor", "pair")),
    Kind("stiffness_follows_aux", "machine", f.stiffness_follows_aux, ("pressure",)),
    Kind("transport_delay", "output", o.output_delay),
    Kind("sensor_lag", "output", o.sensor_lag),
    Kind("sensor_crosstalk", "output", o.sensor_crosstalk, ("pair",)),
    Kind("sensor_misalignment", "machine", o.sensor_misalignment, ("pair",)),
    Kind("sensor_offset", "output", o.sensor_offset, ("spring",)),
    Kind("sensor_drift", "output", o.sensor_drift, ("spring",)),
    Kind("sensor_nonlinearity", "output", o.sensor_nonlinearity),
    Kind("sensor_rectification", "output", o.sensor_rectification),
    Kind("sensor_saturation", "output", o.sensor_saturation),
    Kind("quantisation", "output", o.quantisation),
    Kind("runout", "output", o.runout, ("rotor",)),
    Kind("periodic_disturbance", "output", o.output_tone),
    Kind("gain_follows_aux", "output", o.output_gain_follows_aux),
    Kind("coloured_noise", "output", o.coloured_noise),
)
_UNKNOWN = (
    Kind("memory_polynomial", "input", i.input_memory_polynomial, known=False),
    Kind("parametric_stiffness", "axis", f.parametric_stiffness, known=False),
    Kind("bilinear_coupling", "axis", f.bilinear_coupling, known=False),
    Kind("fractional_damping", "axis", f.axis_fractional_damping, known=False),
    Kind("stick_slip_events", "axis", f.stick_slip_events, known=False),
)


def physics_at(machine: TrialMachine) -> list[tuple[str, str]]:
    """Return every canonical name with every site of the machine where it makes sense, parameter changes left out."""
    return _places(machine, _KNOWN)


def outside_at(machine: TrialMachine) -> list[tuple[str, str]]:
    """Return the physics that is not in the vocabulary, with its sites."""
    return _places(machine, _UNKNOWN)


def changes_at(machine: TrialMachine) -> list[tuple[str, str]]:
    """Return the parameter changes, as ``parameter_change:NAME``, with their sites."""
    return [(f"{CHANGE}:{name}", site) for site, name in machine.changes]


def make_effect(site: EffectSite, physics: str) -> Effect:
    """Return this physics made up at the site; raises `BadInput` when it makes no sense there."""
    if physics.startswith(CHANGE):
        return _change(site, physics.partition(":")[2])
    for kind in (*_KNOWN, *_UNKNOWN):
        if kind.physics == physics and site.name in _sites(site.machine, kind):
            return kind.make(site)
    raise BadInput(f"'{physics}' at '{site.name}' makes no sense on machine '{site.machine.name}'")


def sites_of(machine: TrialMachine, physics: str) -> list[str]:
    """Return the sites where this physics makes sense; raises `BadInput` for an unknown name or none at all."""
    everything = physics_at(machine) + outside_at(machine) + changes_at(machine)
    sites = [site for name, site in everything if name == physics]
    if not sites:
        raise BadInput(f"machine '{machine.name}' has no place for '{physics}'")
    return sites


def _places(machine: TrialMachine, kinds: tuple[Kind, ...]) -> list[tuple[str, str]]:
    return [(kind.physics, site) for kind in kinds for site in _sites(machine, kind)]


def _sites(machine: TrialMachine, kind: Kind) -> list[str]:
    has = {
        "rotor": machine.rotating,
        "pair": len(machine.outputs) == 2,
        "pressure": "pressure" in machine.aux,
        "spring": machine.stable,
    }
    if not all(has[need] for need in kind.needs):
        return []
    count = {"input": len(machine.inputs), "axis": len(machine.axes), "output": len(machine.outputs), "machine": 1}
    name = {"input": machine.input_site, "axis": machine.force_site, "output": machine.output_site}
    return [name[kind.place](n) if kind.place in name else "machine" for n in range(count[kind.place])]


def _change(site: EffectSite, parameter: str) -> Effect:
    """Return a change of a constant by -10 % (severity 1), a loss or a gain at random but for gains, which are lost."""
    shifts = site.machine.changes.get((site.name, parameter))
    if shifts is None:
        raise BadInput(f"machine '{site.machine.name}' has no parameter '{parameter}' at '{site.name}'")
    size = -0.1 if "gain" in parameter else 0.1 * site.sign()
    theta = {site.machine.constant(name): power for name, power in shifts.items()}
    return site.effect(
        CHANGE, c.CONSTANT, (), ("change", "1", size, 1), free=(), parameter=parameter, shifts=theta
    )
