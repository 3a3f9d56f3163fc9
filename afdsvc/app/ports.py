"""The port of a machine's rig: the built-in simulator, one that only steps (an FMI unit, a Python function), a replay, or a driver plugin."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from afdsvc.api.bursts import Limits
from afdsvc.api.clock import Clock
from afdsvc.api.control_plugins import DesignedController
from afdsvc.api.model import SteppedPlant, Variable
from afdsvc.api.port import Port
from afdsvc.api.signals import Channel
from afdsvc.app import commissioning
from afdsvc.errors import BadInput
from afdsvc.files.model.stepped import load_code, refuse_code
from afdsvc.files.site import STEPPED, Fault, MachineSection
from afdsvc.files.tables.tables import read_table
from afdsvc.hal.control_loop import LoopSettings, Prediction
from afdsvc.hal.replay import Replay, blocks_of
from afdsvc.hal.simulator import GainFault, ScheduledFault, SimulatedPlant, SimulatedRig, SpeedProfile, SteppedSimulator
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.plants.registry import plant as plant_by_name
from afdsvc.plants.stepped.fmi_unit import FmiUnit
from afdsvc.plants.stepped.function_plant import FunctionPlant
from afdsvc.plugins.manager import Plugins
from afdsvc.service.clock import FastClock

AT_REST = 0.01  # of an output's limit: how far from zero a simulator may rest


def open_stepped(
    config: MachineSection, sides: tuple[tuple[Variable, ...], tuple[Variable, ...]], controller: DesignedController, output_cov: Array,
    channels: tuple[Channel, ...], limits: Limits, faults: list[Fault], settings: LoopSettings, clock: Clock, prediction: Prediction,
    allow_code: bool = False,
) -> SteppedSimulator:  # fmt: skip
    """Return the port around the simulator a site file names; raises `BadInput` naming what does not fit.

    ``sides`` are the model's inputs and outputs, ``faults`` those of the machine. No simulator is opened without ``allow_code``.
    """
    unit = stepped_plant(config, *sides, allow_code)
    try:
        _refuse_unrest(unit, limits, config.driver.unit or "")
        sites = _gains(faults)
        injected = _gain_faults(config, sites, controller.interconnection.dt)
        return SteppedSimulator(
            unit, output_cov, injected, controller.interconnection, channels, limits, settings, clock, config.driver.seed, prediction, sites
        )
    except BaseException:
        unit.close()
        raise


def stepped_plant(
    config: MachineSection, inputs: tuple[Variable, ...], outputs: tuple[Variable, ...], allow_code: bool
) -> SteppedPlant:
    """Return the simulator of a site file's driver, not begun yet."""
    driver = config.driver
    unit = driver.unit or ""
    refuse_code(unit, unit if driver.kind == "fmu" else unit.rpartition(":")[0], allow_code, "key 'driver.unit'")
    known = [v.name for v in (*inputs, *outputs)]
    stranger = next((name for name in driver.variables if name not in known), None)
    if stranger is not None:
        raise BadInput(f"key 'driver.variables' maps '{stranger}'; the model has {', '.join(known)}")
    if driver.kind == "fmu":
        names = [[driver.variables.get(v.name, v.name) for v in side] for side in (inputs, outputs)]
        return FmiUnit(Path(unit), names[0], names[1], _numbers(driver.options))
    place, _, _ = unit.rpartition(":")
    folder, reference = (Path(place).parent, f"{Path(place).name}{unit[len(place):]}") if place.endswith(".py") else (Path(), unit)
    function = load_code(reference, folder, "key 'driver.unit'")
    if not callable(function):
        raise BadInput(f"key 'driver.unit' names {unit}, which is not a function; expected function(x, u, dt) -> (x, y)")
    return FunctionPlant(function, unit, len(inputs), len(outputs), driver.options)


def _numbers(options: dict[str, Any]) -> dict[str, float]:
    for name, value in options.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise BadInput(f"key 'driver.options.{name}' is {value!r}; expected a number for a parameter of an FMI unit")
    return {name: float(value) for name, value in options.items()}


def _refuse_unrest(unit: SteppedPlant, limits: Limits, name: str) -> None:
    y = unit.begin()
    far = np.abs(y) > AT_REST * limits.output
    if far.any():
        at = int(np.flatnonzero(far)[0])
        raise BadInput(f"simulator {name} starts with output {at} at {y[at]:g}; expected deviations from an operating point at 0")


def _gains(faults: list[Fault]) -> dict[str, tuple[str, int]]:
    """Return by name the gains that are faults of a machine, as (side, index)."""
    kinds = {"actuator_gain": "input", "sensor_gain": "output"}
    return {f.name: (kinds[f.kind], int(f.settings[kinds[f.kind]])) for f in faults if f.kind in kinds}


def _gain_faults(config: MachineSection, possible: Mapping[str, tuple[str, int]], dt: float) -> list[GainFault]:
    """Return what the site injects; a simulator that is closed to us can lose gain at its ends, nothing else."""
    made = []
    for f in config.driver.faults:
        if f.name not in possible:
            raise BadInput(f"fault '{f.name}' cannot be injected into a stepped simulator; gain faults can: {', '.join(possible) or 'none'}")
        side, index = possible[f.name]
        made.append(GainFault(side, index, f.severity, round(f.at_seconds / dt)))
    return made


def open_port(machine: commissioning.Commissioned, session: str, clock: Clock, plugins: Plugins) -> Port:
    """Return the machine's port: the simulator, a replay, or a driver plugin."""
    driver = machine.config.driver
    settings = LoopSettings(machine.config.id, session, machine.config.block, sensor_range=machine.config.limits.sensor_range)
    if driver.kind == "replay":
        trace = read_table(driver.recording or Path())
        pace = clock if driver.real_time else FastClock(clock.now_ns())
        return Replay(blocks_of(trace, machine.config.id, session, clock.now_ns(), machine.config.block), pace)
    if driver.kind == "simulator":
        return _simulator(machine, settings, clock)
    if driver.kind in STEPPED:
        return _stepped(machine, settings, clock)
    port: Port = plugins.get("drivers", driver.kind).open(machine, settings, clock, driver.settings)
    return port


def _stepped(machine: commissioning.Commissioned, settings: LoopSettings, clock: Clock) -> Port:
    expected, config = commissioning.prediction(machine), machine.config
    if machine.controller is None or machine.limits is None or machine.output_cov is None:
        raise BadInput(f"machine '{config.id}' has no controller, limits or noise; it can only be replayed")
    faults = commissioning.default_faults(machine.inputs, machine.outputs) if config.faults is None else config.faults
    return open_stepped(
        config, (machine.inputs, machine.outputs), machine.controller, machine.output_cov, machine.channels, machine.limits, faults,
        settings, clock, expected, machine.allow_code,
    )  # fmt: skip


def _simulator(machine: commissioning.Commissioned, settings: LoopSettings, clock: Clock) -> SimulatedRig:
    dt, driver, noise = machine.plant.dt, machine.config.driver, machine.output_cov
    if machine.controller is None or machine.limits is None or noise is None:
        raise BadInput(f"machine '{machine.config.id}' has no controller or no noise; it can only be replayed")
    known = machine.augmented.fault_names
    for f in driver.faults:
        if f.name not in known:
            raise BadInput(f"fault '{f.name}' is unknown; this machine has {', '.join(known)}")
    faults = tuple(ScheduledFault(f.name, f.severity, round(f.at_seconds / dt)) for f in driver.faults)
    plant = _simulated(machine, noise, faults)
    interconnection = machine.controller.interconnection
    return SimulatedRig(
        plant, interconnection, machine.channels, machine.limits, settings, clock, driver.seed, commissioning.prediction(machine)
    )


def _simulated(machine: commissioning.Commissioned, noise: Array, faults: tuple[ScheduledFault, ...]) -> SimulatedPlant:
    """Return what is simulated: the model itself, or another one where the driver says so or the speed changes."""
    driver, config, physical = machine.config.driver, machine.config, machine.physical
    names = machine.augmented.fault_names
    faulty, disturbed = machine.faults, None if config.input_sd is None else np.diag(np.square(config.input_sd))
    if physical is None or faulty is None or not (driver.options or driver.speed):
        unbalance = None if physical is None else physical.unbalance
        return SimulatedPlant(machine.augmented.close, noise, disturbed, machine.speed, unbalance, faults, names=names)
    true = plant_by_name(config.plant or "", **{**config.options, **driver.options})
    if true.sample_time != physical.sample_time:
        raise BadInput(f"key 'driver.options' gives sample time {true.sample_time} s; the machine's is {physical.sample_time} s")
    profile = SpeedProfile.of([(t, 2 * np.pi * rpm / 60) for t, rpm in driver.speed], true.speed, true.sample_time)

    def turning(severities: Mapping[str, float], speed: float) -> StateSpace:
        return faulty.true_plant(commissioning.plant_at_speed(true, speed), severities)

    def still(severities: Mapping[str, float]) -> StateSpace:
        return turning(severities, true.speed)

    return SimulatedPlant(still, noise, disturbed, true.speed, true.unbalance, faults, profile, turning, names)


