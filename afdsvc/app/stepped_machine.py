"""Machines of a MODEL.toml that are driven, not only watched: their limits, their sample time, and the simulators that only step."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from afdsvc.api.bursts import Limits
from afdsvc.api.clock import Clock
from afdsvc.api.control_plugins import DesignedController
from afdsvc.api.model import Model, SteppedPlant, Variable
from afdsvc.api.signals import Channel
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import read_model
from afdsvc.files.model.user_code import load_code, refuse_code
from afdsvc.files.site import STEPPED, Fault, MachineSection
from afdsvc.hal.control_loop import LoopSettings, Prediction
from afdsvc.hal.stepped_simulator import GainFault, SteppedSimulator
from afdsvc.lti.statespace import Array
from afdsvc.plants.stepped.fmi_unit import FmiUnit
from afdsvc.plants.stepped.function_plant import FunctionPlant

AT_REST = 0.01  # of an output's limit: how far from zero a simulator may rest


def is_driven(config: MachineSection) -> bool:
    """Whether a machine with a model runs in a loop of ours; a replay is only watched."""
    return config.driver.kind != "replay"


def driven_model(config: MachineSection, allow_code: bool) -> tuple[Model, float]:
    """Return a driven machine's model and sample time [s]; raises `BadInput` when nothing states it.

    A model that is itself a simulator is opened where the driver is one too and code may run.
    """
    model = read_model(config.model or Path(), allow_code and config.driver.kind in STEPPED)
    stated = config.options.get("sample_time", 0.0)
    dt = model.sample_time or (model.plant.dt if model.plant else 0.0) or stated
    if not (isinstance(dt, (int, float)) and dt > 0):
        raise BadInput(f"{model.origin}: states no sample time; expected key 'options.sample_time' [s] in the site file")
    return model, float(dt)


def stated_limits(config: MachineSection) -> Limits:
    """Return the limits of the site file; a model knows none, so all that can do harm must be stated."""
    for name in ("output", "input"):
        if getattr(config.limits, name) is None:
            raise BadInput(f"key 'limits.{name}' is missing; a driven machine with 'model' needs bounds for every {name}")
    u = np.array(config.limits.input, dtype=float)
    alpha = 10 * u if config.limits.alpha is None else np.array(config.limits.alpha, dtype=float)
    return Limits(np.array(config.limits.output, dtype=float), u, alpha, config.limits.seconds)


def checked_limits(limits: Limits, inputs: int, outputs: int) -> Limits:
    """Return the limits where there is one per channel; raises `BadInput` otherwise."""
    for name, found, wanted in (("output", limits.output, outputs), ("input", limits.input, inputs), ("alpha", limits.alpha, inputs)):
        if len(found) != wanted:
            raise BadInput(f"key 'limits.{name}' has {len(found)} values; expected {wanted}")
    return limits


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
        injected = _gain_faults(config, faults, controller.interconnection.dt)
        return SteppedSimulator(
            unit, output_cov, injected, controller.interconnection, channels, limits, settings, clock, config.driver.seed, prediction
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
        raise BadInput(f"key 'driver.unit' names {unit}, which is no function; expected function(x, u, dt) -> (x, y)")
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


def _gain_faults(config: MachineSection, faults: list[Fault], dt: float) -> list[GainFault]:
    """Return what the site injects; a simulator that is closed to us can lose gain at its ends, nothing else."""
    kinds = {"actuator_gain": "input", "sensor_gain": "output"}
    possible = {f.name: (kinds[f.kind], int(f.settings[kinds[f.kind]])) for f in faults if f.kind in kinds}
    made = []
    for f in config.driver.faults:
        if f.name not in possible:
            raise BadInput(f"fault '{f.name}' cannot be injected into a stepped simulator; gain faults can: {', '.join(possible) or 'none'}")
        side, index = possible[f.name]
        made.append(GainFault(side, index, f.severity, round(f.at_seconds / dt)))
    return made
