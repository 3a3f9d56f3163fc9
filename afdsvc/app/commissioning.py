"""From one machine of the site file to concrete parts: plant, controller, faults, residual, limits, port, detectors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from afdsvc.api.bursts import Limits
from afdsvc.api.control_plugins import DesignedController
from afdsvc.api.detection import DetectionProblem, FalseAlarms, Noise
from afdsvc.api.model import Model, Variable
from afdsvc.api.plant import PhysicalPlant
from afdsvc.api.signals import Channel
from afdsvc.dataset.experiment import sampled
from afdsvc.detect.uncertain_parameters import uncertain_entries
from afdsvc.errors import BadInput, NotStabilising
from afdsvc.excite.amplitude_budget import noise_deviations
from afdsvc.files import site as site_file
from afdsvc.files.model.model_file import model_text, read_model
from afdsvc.files.tables.tables import read_table
from afdsvc.hal.control_loop import Prediction
from afdsvc.lti.lft import AugmentedPlant, FaultDirection, augment, star
from afdsvc.lti.python_control import factorise
from afdsvc.lti.sampling import sample_noise, sample_zoh
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.whitening import innovations, whitening_filter
from afdsvc.lti.yjbk import excited_controller, interconnection
from afdsvc.plants.registry import plant as plant_by_name
from afdsvc.plugins.controllers.lqg import lqg_gains
from afdsvc.plugins.fault_set import FaultSet, chosen_faults, usual_faults
from afdsvc.plugins.manager import Plugins


@dataclass(frozen=True, slots=True, eq=False)
class Commissioned:
    """One machine, ready to be run, watched or diagnosed; its driver may run user code only with ``allow_code``.

    ``plant`` is the nominal discrete plant; ``controller`` None when unknown (then the machine is watched only).
    """

    config: site_file.MachineSection
    plant: StateSpace
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    output_cov: Array | None
    process_cov: Array | None
    controller: DesignedController | None
    augmented: AugmentedPlant
    limits: Limits | None
    channels: tuple[Channel, ...]
    speed: float = 0.0
    raw_model: str = ""
    physical: PhysicalPlant | None = None
    faults: FaultSet | None = None
    allow_code: bool = False
    uncertain: AugmentedPlant | None = None
    uncertainty: Mapping[str, float] = field(default_factory=dict)

    @property
    def noise(self) -> Noise | None:
        """The stated noise, None where it is not stated."""
        return None if self.output_cov is None else Noise(self.output_cov, self.process_cov)

    def model_text(self) -> str:
        """Return what the simulation believes as MODEL.toml text, for recordings."""
        if self.raw_model:
            return self.raw_model
        states = tuple(Variable(f"x{i + 1}") for i in range(self.plant.order))
        sd = None if self.output_cov is None else np.sqrt(np.diag(self.output_cov))
        controller = self.controller.factorisation.K if self.controller else None
        return model_text(Model(
            self.config.id, self.inputs, self.outputs, states, self.plant, sample_time=self.plant.dt, output_sd=sd,
            controller=controller,
        ))  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class RecordedMachine:
    """What is known of a machine that has no plant of ours: its model, and how its samples look."""

    model: Model
    dt: float
    channels: tuple[Channel, ...]


def commission(
    config: site_file.MachineSection, plugins: Plugins, watched: RecordedMachine | None = None, allow_code: bool = False
) -> Commissioned:
    """Return the machine's parts; raises `BadInput` that names the machine and what is wrong with it.

    ``watched`` replaces the files that a machine with ``model`` is otherwise read from. ``allow_code`` permits the simulator that
    the site file names (an FMI unit, a Python function) to run, here and in `open_port`.
    """
    try:
        if config.plant:
            return replace(_from_plant(config, plugins), allow_code=allow_code)
        return replace(_from_model(config, plugins, watched or _read_watched(config, allow_code)), allow_code=allow_code)
    except BadInput as error:
        raise type(error)(f"machine '{config.id}': {error}") from error


def commission_embedded(
    text: str, origin: str, id: str, plugins: Plugins, watched: RecordedMachine | None = None
) -> Commissioned:
    """Return a machine as the site file inside a recording describes it: no driver, no user code and no model file is opened.

    Raises `BadInput` when only a file outside the recording says what the machine is.
    """
    config = site_file.parse_site(text, origin).machine(id)
    if config.model and watched is None:
        raise BadInput(f"{origin}: machine '{id}' has a model that is not inside the recording; expected --model MODEL.toml")
    return commission(config, plugins, watched)


def _from_plant(config: site_file.MachineSection, plugins: Plugins) -> Commissioned:
    physical = plant_by_name(config.plant or "", **config.options)
    discrete = physical.discrete()
    designed = plugins.get("controllers", config.controller.kind).design(discrete, _controller_settings(config.controller, physical))
    controller = _excited(designed, config.bursts.through)
    output_cov = physical.output_cov if config.output_sd is None else np.diag(np.square(config.output_sd))
    limits = _limits(config, physical.output_limit, physical.input_limit)
    faults = _faults(config, physical, plugins)
    turns = bool(physical.speed or any(rpm for _, rpm in config.driver.speed))
    return Commissioned(
        config, discrete, physical.inputs, physical.outputs, output_cov, _disturbance(config, discrete), controller, faults.augmented(physical), limits,
        _channels(physical.inputs, physical.outputs, config.bursts.through, turns), physical.speed, physical=physical, faults=faults,
        uncertain=_uncertain(config, physical), uncertainty=config.uncertainty,
    )  # fmt: skip


def _uncertain(config: site_file.MachineSection, physical: PhysicalPlant) -> AugmentedPlant | None:
    """Return the plant with the parameters pulled out that the site file calls uncertain; None where it names none."""
    strange = sorted(set(config.uncertainty) - set(physical.parameters))
    if strange:
        raise BadInput(f"key 'uncertainty': plant '{physical.name}' has no parameter '{strange[0]}'; it has {', '.join(physical.parameters)}")
    return physical.faults(list(config.uncertainty)) if config.uncertainty else None


def _faults(config: site_file.MachineSection, physical: PhysicalPlant, plugins: Plugins) -> FaultSet:
    """Return the faults of the site file, or the plant's usual ones when it names none."""
    if config.faults is None:
        return usual_faults(physical)
    return chosen_faults([(f.name, plugins.get("faults", f.kind), f.settings) for f in config.faults])


def at_speed(machine: Commissioned, speed: float) -> Commissioned:
    """Return the machine with the model of another speed [rad/s]; its controller stays the one it runs with.

    Raises `BadInput` for a machine that has no model there, `NotStabilising` when the controller does not hold it there.
    """
    if machine.physical is None or machine.faults is None or machine.controller is None:
        raise BadInput(f"machine '{machine.config.id}' has no built-in plant; its model is valid at one speed only")
    physical = plant_at_speed(machine.physical, speed)
    K = machine.controller.factorisation.K
    worst = float(np.abs(star(physical.discrete(), K, K.inputs, K.outputs).poles()).max())
    if worst >= 1:
        raise NotStabilising(f"machine '{machine.config.id}': the loop at {speed * 30 / np.pi:.0f} rpm has a pole of modulus {worst:.6g}")
    augmented = machine.faults.augmented(physical)
    process = _disturbance(machine.config, augmented.plant)
    uncertain = _uncertain(machine.config, physical)
    return replace(machine, plant=augmented.plant, augmented=augmented, speed=speed, physical=physical, process_cov=process, uncertain=uncertain)


def _read_watched(config: site_file.MachineSection, allow_code: bool) -> RecordedMachine:
    if is_driven(config):
        model, dt = driven_model(config, allow_code)
        return RecordedMachine(model, dt, _channels(model.inputs, model.outputs, config.bursts.through, False))
    trace = read_table(config.driver.recording or Path())
    return RecordedMachine(read_model(config.model or Path()), trace.dt, trace.channels)


def is_driven(config: site_file.MachineSection) -> bool:
    """Whether a machine with a model runs in a loop of ours; a replay is only watched."""
    return config.driver.kind != "replay"


def driven_model(config: site_file.MachineSection, allow_code: bool) -> tuple[Model, float]:
    """Return a driven machine's model and sample time [s]; raises `BadInput` when nothing states it.

    A model that is itself a simulator is opened where the driver is one too and code may run.
    """
    model = read_model(config.model or Path(), allow_code and config.driver.kind in site_file.STEPPED)
    stated = config.options.get("sample_time", 0.0)
    dt = model.sample_time or (model.plant.dt if model.plant else 0.0) or stated
    if not (isinstance(dt, (int, float)) and dt > 0):
        raise BadInput(f"{model.origin}: states no sample time; expected key 'options.sample_time' [s] in the site file")
    return model, float(dt)


def stated_limits(config: site_file.MachineSection) -> Limits:
    """Return the limits of the site file; a model knows none, so all that can do harm must be stated."""
    for name in ("output", "input"):
        if getattr(config.limits, name) is None:
            raise BadInput(f"key 'limits.{name}' is missing; a driven machine with 'model' needs bounds for every {name}")
    u = np.array(config.limits.input, dtype=float)
    y = np.array(config.limits.output, dtype=float)
    alpha = excitation_limit(config, y, u) if config.limits.alpha is None else np.array(config.limits.alpha, dtype=float)
    return Limits(y, u, alpha, config.limits.seconds)


def excitation_limit(config: site_file.MachineSection, output: Array, input: Array) -> Array:
    """Return the bound of the excitation where none is stated.

    Alpha enters before the controller's own feedback, which takes most of it back: u and y are what can do harm.
    """
    return {"alpha": 10 * input, "input": input, "setpoint": output}[config.bursts.through]


def checked_limits(limits: Limits, inputs: int, outputs: int) -> Limits:
    """Return the limits where there is one per channel; raises `BadInput` otherwise."""
    for name, found, expected in (("output", limits.output, outputs), ("input", limits.input, inputs), ("alpha", limits.alpha, inputs)):
        if len(found) != expected:
            raise BadInput(f"key 'limits.{name}' has {len(found)} values; expected {expected}")
    return limits


def _from_model(config: site_file.MachineSection, plugins: Plugins, watched: RecordedMachine) -> Commissioned:
    """A model file describes a machine that is watched in the loop of the controller it states, or driven in a loop of ours."""
    model = watched.model
    if model.plant is None:
        raise BadInput(f"{model.origin}: expected a linear model (A, B, C, D) to watch a machine")
    discrete = model.plant if model.plant.discrete else sample_zoh(model.plant, watched.dt)
    if abs(discrete.dt - watched.dt) > 1e-6 * watched.dt:
        raise BadInput(f"{model.origin}: sample_time {discrete.dt:g} s; the recording is sampled at {watched.dt:g} s")
    names = [*(f"u_{v.name}" for v in model.inputs), *(f"y_{v.name}" for v in model.outputs)]
    missing = sorted(set(names) - {c.name for c in watched.channels})
    if missing:
        raise BadInput(f"{model.origin}: the samples have no column {', '.join(missing)}; expected the model's names")
    controller = limits = None
    if is_driven(config):
        limits = checked_limits(stated_limits(config), len(model.inputs), len(model.outputs))
        controller = plugins.get("controllers", config.controller.kind).design(discrete, config.controller.settings)
    elif model.controller is not None:
        controller = _stated_controller(model, discrete)
    controller = _excited(controller, config.bursts.through)
    uncertain = uncertain_entries(model.plant, model.entry_sd, discrete.dt) if model.sd_stated else None
    return Commissioned(
        config, discrete, model.inputs, model.outputs, _model_cov(config, model), _disturbance(config, discrete, _process_cov(model, discrete.dt)), controller,
        augment(discrete, _directions(config, discrete, model.inputs, model.outputs, plugins)),
        limits, watched.channels, raw_model=model.raw, uncertain=uncertain,
        uncertainty=dict.fromkeys(uncertain.fault_names, 1.0) if uncertain else {},
    )  # fmt: skip


def _excited(controller: DesignedController | None, through: str) -> DesignedController | None:
    """Return the controller with its excitation input where the site file wants it; raises `BadInput` where there is none."""
    if controller is None or through == "alpha":
        return controller
    plant = controller.factorisation.plant
    if plant.inputs != plant.outputs:
        raise BadInput(f"key 'bursts.through' = '{through}' is for machines with as many outputs as inputs; this one has {plant.outputs} and {plant.inputs}")
    return replace(controller, interconnection=excited_controller(controller.factorisation, through))


def _stated_controller(model: Model, plant: StateSpace) -> DesignedController:
    """Return the controller a model states, as it closes the loop around the plant; raises `BadInput` where it cannot."""
    assert model.controller is not None  # noqa: S101 - asked for where one is stated
    K = sampled(model.controller, plant.dt)
    if K is None:
        raise BadInput(f"{model.origin}: [controller] has sample_time {model.controller.dt:g} s; expected {plant.dt:g} s, that of the samples")
    try:
        fact = factorise(plant, K)
    except BadInput as error:
        raise BadInput(f"{model.origin}: [controller]: {error}; state the controller that ran (positive feedback, u = K y)") from error
    return DesignedController("stated", fact, interconnection(fact), f"the controller of the model, of order {K.order}")


def _process_cov(model: Model, dt: float) -> Array | None:
    """Return the covariance of the noise on the states per sample; a continuous model states an intensity."""
    if model.process_cov is None or model.plant is None or model.plant.discrete:
        return model.process_cov
    return sample_noise(model.plant.A, model.process_cov, dt)


def _disturbance(config: site_file.MachineSection, plant: StateSpace, otherwise: Array | None = None) -> Array | None:
    """Return the covariance on the states of the white noise that the site states at the inputs."""
    if config.input_sd is None:
        return otherwise
    if len(config.input_sd) != plant.inputs:
        raise BadInput(f"key 'input_sd' has {len(config.input_sd)} values; expected {plant.inputs}, one per input")
    scaled = plant.B * np.array(config.input_sd)
    return np.asarray(scaled @ scaled.T, dtype=np.float64)


def controller_settings(machine: Commissioned) -> Mapping[str, Any]:
    """Return the settings the machine's controller was designed with."""
    chosen = machine.config.controller
    return chosen.settings if machine.physical is None else _controller_settings(chosen, machine.physical)


def _controller_settings(controller: site_file.PluginSection, plant: PhysicalPlant) -> Mapping[str, Any]:
    """A plant may recommend settings for a controller; the site file overrides them."""
    return {**plant.recommended.get(controller.kind, {}), **controller.settings}


def _model_cov(config: site_file.MachineSection, model: Model) -> Array | None:
    sd = config.output_sd if config.output_sd is not None else model.output_sd
    return None if sd is None else np.diag(np.square(np.asarray(sd, dtype=float)))


def _directions(
    config: site_file.MachineSection,
    plant: StateSpace,
    inputs: tuple[Variable, ...],
    outputs: tuple[Variable, ...],
    plugins: Plugins,
) -> list[FaultDirection]:
    """Return the faults of the site file, or a gain fault on every actuator and sensor when it names none."""
    faults = config.faults if config.faults is not None else default_faults(inputs, outputs)
    return [plugins.get("faults", f.kind).direction(plant, f.name, f.settings) for f in faults]


def default_faults(inputs: tuple[Variable, ...], outputs: tuple[Variable, ...]) -> list[site_file.Fault]:
    """Return a gain fault on every actuator and every sensor."""
    actuators = [
        site_file.Fault(name=f"{v.name}_actuator", kind="actuator_gain", settings={"input": i}) for i, v in enumerate(inputs)
    ]
    return actuators + [
        site_file.Fault(name=f"{v.name}_sensor", kind="sensor_gain", settings={"output": i}) for i, v in enumerate(outputs)
    ]


def _limits(config: site_file.MachineSection, output: Array, input: Array) -> Limits:
    settings = config.limits

    def bound(name: str, value: list[float] | None, default: Array) -> Array:
        chosen = default if value is None else np.asarray(value, dtype=float)
        if chosen.shape != default.shape:
            raise BadInput(f"key 'limits.{name}' has {chosen.size} values; expected {default.size}")
        if (chosen > default).any() and name != "alpha":
            raise BadInput(f"key 'limits.{name}' is {chosen.tolist()}; at most {default.tolist()}, the plant's own limit")
        return np.asarray(chosen, dtype=float)

    y, u = bound("output", settings.output, output), bound("input", settings.input, input)
    return Limits(y, u, bound("alpha", settings.alpha, excitation_limit(config, y, u)), settings.seconds)


def _channels(inputs: tuple[Variable, ...], outputs: tuple[Variable, ...], through: str, turns: bool) -> tuple[Channel, ...]:
    """Return the channels in the order of `hal.loop.Samples.values`."""
    columns = [Channel(f"u_{v.name}", v.unit) for v in inputs] + [Channel(f"y_{v.name}", v.unit) for v in outputs]
    role = "alpha" if through == "alpha" else "ref"
    columns += [Channel(f"{role}_{v.name}", v.unit) for v in (outputs if through == "setpoint" else inputs)]
    columns += [Channel(f"beta_{v.name}", v.unit) for v in outputs]
    if turns:
        columns += [Channel("aux_speed", "rad/s"), Channel("aux_angle", "rad")]
    return tuple(columns)


def problem(machine: Commissioned, noise: Noise, alarms: FalseAlarms) -> DetectionProblem:
    """Return the detection problem for known noise; raises `BadInput` when the plant is undetectable from its outputs."""
    residual = innovations(machine.plant, noise.output_cov, noise.process_cov, noise.cross_cov)
    jk, whitening = _loop(machine, noise)
    return DetectionProblem(
        machine.config.id,
        machine.plant,
        machine.augmented,
        jk,
        residual.filter,
        whitening,
        residual.covariance,
        tuple(v.name for v in machine.outputs),
        alarms,
        tuple(v.name for v in machine.inputs),
        limits=machine.limits,
        output_cov=noise.output_cov,
        process_cov=noise.process_cov,
        cross_cov=noise.cross_cov,
        noise_samples=noise.samples,
        speed=machine.speed,
        loop_known=machine.controller is not None,
        through=machine.config.bursts.through,
        uncertain=machine.uncertain,
        uncertainty=machine.uncertainty,
    )


def _loop(machine: Commissioned, noise: Noise) -> tuple[StateSpace, StateSpace]:
    """Return J_K and the filter from beta to r.

    Where no controller is stated, the LQ controller of the nominal model stands in: the passive detectors need some loop to
    reckon what its noise gives away. What bursts do in such a loop is not known.
    """
    if machine.controller is None:
        return _stand_in(machine.plant), StateSpace.gain(np.eye(machine.plant.outputs), machine.plant.dt)
    fact = machine.controller.factorisation
    return machine.controller.interconnection, whitening_filter(fact, noise.output_cov, noise.process_cov, 0.0, noise.cross_cov)[0]


def _stand_in(G: StateSpace) -> StateSpace:
    """Return J_K of the observer-based LQ controller with default weights (D of the plant included)."""
    F, L = lqg_gains(G, {})
    A = G.A + G.B @ F + L @ (G.C + G.D @ F)
    C = np.vstack([F, -(G.C + G.D @ F)])
    D = np.block([[np.zeros((G.inputs, G.outputs)), np.eye(G.inputs)], [np.eye(G.outputs), -G.D]])
    return StateSpace(A, np.hstack([-L, G.B + L @ G.D]), C, D, G.dt)


def prediction(machine: Commissioned) -> Prediction:
    """Return how the excitation shows in u and y of the nominal loop, and the peak of the noise to allow for."""
    if machine.controller is None or machine.noise is None:
        raise BadInput(f"machine '{machine.config.id}' has no controller or no noise ('output_sd'); bursts cannot be predicted")
    both = machine.controller.factorisation.R.select(slice(None), range(machine.plant.inputs))  # M and N
    if machine.config.bursts.through != "alpha":
        both = _answer(machine.plant, machine.controller.interconnection)
    y_sd, _ = noise_deviations(problem(machine, machine.noise, FalseAlarms()))
    return Prediction(both, 5 * y_sd)


def _answer(g: StateSpace, controller: StateSpace) -> StateSpace:
    """Return the loop from the excitation to ``[u, y]``."""
    n, m, p = g.order, g.inputs, g.outputs
    C, D = np.vstack([np.zeros((m, n)), g.C, g.C]), np.vstack([np.eye(m), g.D, g.D])
    return star(StateSpace(g.A, g.B, C, D, g.dt), controller, p, m).select(slice(0, m + p), slice(None))


def plant_at_speed(physical: PhysicalPlant, speed: float) -> PhysicalPlant:
    """Return the plant at a speed [rad/s]; raises `BadInput` for a plant that is known at one speed only."""
    if speed == physical.speed:
        return physical
    if physical.at_speed is None:
        raise BadInput(f"plant '{physical.name}' is known at {physical.speed:.4g} rad/s only, not at {speed:.4g} rad/s")
    return physical.at_speed(speed)
