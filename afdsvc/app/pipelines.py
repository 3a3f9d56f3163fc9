"""A machine's pipeline from blocks to evidence, and the design of its bursts and of its Q."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import asdict, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import DetectionProblem, Detector, FalseAlarms, Noise
from afdsvc.api.retuning import DiagnosedFault, LoopCost, Tuning
from afdsvc.app import commissioning
from afdsvc.app.commissioning import Commissioned, controller_settings
from afdsvc.diagnosis.data_quality import Expectation
from afdsvc.diagnosis.pipeline import CalibratedPipeline, Design, ExcitableStream, Pipeline, calibrated
from afdsvc.diagnosis.speed_schedule import SpeedPipeline
from afdsvc.errors import BadInput
from afdsvc.excite.diagnosis_burst import Aim, default_burst, second_burst, stated_burst
from afdsvc.excite.identification_bursts import Band, multisine_burst, random_binary_burst, sweep_burst
from afdsvc.files.tables.tables import read_table
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.plugins.manager import Plugins
from afdsvc.retune.cost import WEIGHTS, deviations, loop_cost, signal_model, with_q
from afdsvc.retune.proof import Proof, proved_tuning
from afdsvc.retune.settings import stated
from afdsvc.service.retuning import Design as TuningDesign
from afdsvc.service.scheduler import BurstOrder


def pipeline_of(
    machine: Commissioned, plugins: Plugins, ready: Callable[[DetectionProblem], object] | None = None, beside: Executor | None = None
) -> ExcitableStream:
    """Return the machine's way from blocks to evidence, calibrated on its first quiet data where the site wants that.

    A machine with ``speed_step_rpm`` has one way for every speed; ``ready`` is called with the problem of each, and those of
    later speeds are made by ``beside`` when that is given.
    """
    if machine.config.speed_step_rpm:
        made = _speed_pipeline(machine, plugins, ready)
        made.later = beside.submit if beside else None
        return made
    design = _design(machine, plugins)
    samples = round(machine.config.calibrate_seconds / machine.plant.dt)
    if machine.config.calibrate_on:
        return calibrated(machine.plant, *quiet_samples(machine, samples), design)[0]
    if samples:
        return CalibratedPipeline(machine.plant, expectation(machine, 0), samples, design)
    return design(_stated_noise(machine), 50)


def _stated_noise(machine: Commissioned) -> Noise:
    if machine.noise is None:
        raise BadInput(f"machine '{machine.config.id}': the noise is unknown; set 'output_sd' or 'calibrate_seconds'")
    return machine.noise


def _design(machine: Commissioned, plugins: Plugins) -> Design:
    def design(noise: Noise, frozen_after: int) -> Pipeline:
        base = commissioning.problem(machine, noise, FalseAlarms())
        expected, redesign = expectation(machine, frozen_after), partial(detectors, machine, plugins=plugins)
        return Pipeline(base, redesign(base), expected, redesign=redesign)

    return design


def expectation(machine: Commissioned, frozen_after: int = 50) -> Expectation:
    """Return what the machine's blocks must look like."""
    return Expectation(machine.channels, machine.plant.dt, frozen_after)


def detectors(machine: Commissioned, base: DetectionProblem, plugins: Plugins) -> list[Detector]:
    """Return the designed detectors of the machine, each with its own share of the false alarms."""
    made = []
    for chosen in machine.config.detectors:
        alarms = FalseAlarms(chosen.false_alarms_per_1000_bursts / 1000, chosen.false_alarms_per_day / 24)
        design = plugins.get("detectors", chosen.kind)
        made.append(design.design(replace(base, false_alarms=alarms), chosen.settings))
    return made


def quiet_samples(machine: Commissioned, samples: int) -> tuple[Array, Array]:
    """Return u and y of the first samples of the recording the noise is calibrated on."""
    trace = read_table(machine.config.calibrate_on or Path())
    if len(trace) < samples:
        raise BadInput(f"{trace.name}: {len(trace)} samples; expected {samples} for calibration")
    return trace.span(0, samples).role("u"), trace.span(0, samples).role("y")


def _speed_pipeline(machine: Commissioned, plugins: Plugins, ready: Callable[[DetectionProblem], object] | None) -> SpeedPipeline:
    """Return the pipeline of a machine whose speed changes; what was designed for a speed is kept."""
    if "aux_speed" not in {c.name for c in machine.channels}:
        raise BadInput(f"machine '{machine.config.id}' does not turn; 'speed_step_rpm' is for one that records aux_speed")
    noise, kept = _stated_noise(machine), dict[float, Pipeline]()

    def design(speed: float) -> Pipeline:
        if speed not in kept:
            kept[speed] = _design(commissioning.at_speed(machine, speed), plugins)(noise, 50)
            if ready:
                ready(kept[speed].problem)
        made = kept[speed]
        return Pipeline(made.problem, made.detectors, made.expected)

    return SpeedPipeline(design, (machine.config.speed_step_rpm or 0.0) * np.pi / 30, machine.speed)


def diagnosis_burst(machine: Commissioned) -> Callable[[DetectionProblem], Burst]:
    """Return the design of the machine's diagnosis burst, or the one its site states, computed once for every problem."""

    @lru_cache(maxsize=64)
    def design(problem: DetectionProblem) -> Burst:
        settings, limits, id = machine.config.bursts, machine.limits, machine.config.id
        if limits is None:
            raise BadInput(f"machine '{id}' can be watched, not excited; there is no burst to design")
        if not settings.lines:
            return default_burst(problem, limits, settings.seconds, settings.output_amplitude, Aim(severity=settings.severity))
        unknown = next((line.input for line in settings.lines if line.input not in problem.input_names), None)
        if unknown is not None:
            raise BadInput(f"machine '{id}': bursts.lines names input '{unknown}'; expected one of {', '.join(problem.input_names)}")
        lines = [Line(problem.input_names.index(line.input), line.rad_s, line.alpha) for line in settings.lines]
        return stated_burst(problem, limits, settings.seconds, lines, settings.severity)

    return design


def burst_design(
    machine: Commissioned, stream: ExcitableStream, diagnosis: Callable[[DetectionProblem], Burst] | None = None
) -> Callable[[BurstOrder], Burst]:
    """Return the design of the machine's bursts by purpose, for the speed the machine runs at."""
    settings, limits = machine.config.bursts, machine.limits
    if limits is None:
        raise BadInput(f"machine '{machine.config.id}' can be watched, not excited")
    diagnosis = diagnosis or diagnosis_burst(machine)
    if not isinstance(stream, CalibratedPipeline) or stream.pipeline:
        diagnosis(stream.problem)  # what is wrong with it shows before anything moves
    rng = np.random.default_rng(0)

    def design(order: BurstOrder) -> Burst:
        problem = stream.problem
        if order.purpose == "diagnose":
            return diagnosis(problem)
        if order.question:
            return second_burst(problem, limits, order.question.weights, order.question.severity, settings.seconds)
        return identification_burst(machine, order.purpose, rng)

    return design



IDENTIFICATION = {"identify": "multisine", "identify_binary": "random binary", "identify_sweep": "sweep"}


def identification_burst(machine: Commissioned, purpose: str, rng: np.random.Generator) -> Burst:
    """Return a broad burst for identification, as large as half the room its nominal answer leaves within the limits.

    ``purpose`` is ``identify`` (odd random-phase multisine with detection lines), ``identify_binary`` or ``identify_sweep``.
    """
    limits, dt = machine.limits, machine.plant.dt
    if purpose not in IDENTIFICATION or limits is None:
        raise BadInput(f"burst purpose '{purpose}'; expected one of diagnose, {', '.join(IDENTIFICATION)}")
    seconds = min(limits.seconds, 10.0)
    unit = _broad(purpose, Band(4 / seconds, 0.12 / dt, np.ones(machine.plant.inputs), dt), seconds, rng)
    expected = commissioning.prediction(machine)
    answer = np.abs(simulate(expected.system, unit.play(dt))[0]).max(axis=0)
    room = np.concatenate([limits.input, limits.output - expected.noise])
    size = 0.5 * float(np.min(room / np.maximum(answer, 1e-300)))
    size = min(size, float(np.min(limits.alpha / np.maximum(np.abs(unit.play(dt)).max(axis=0), 1e-300))))
    lines = tuple(replace(line, amplitude=size * line.amplitude) for line in unit.lines)
    return replace(unit, lines=lines, waveform=None if unit.waveform is None else size * unit.waveform)


def _broad(purpose: str, band: Band, seconds: float, rng: np.random.Generator) -> Burst:
    if purpose == "identify_binary":
        return random_binary_burst(band, seconds, rng)
    return sweep_burst(band, seconds) if purpose == "identify_sweep" else multisine_burst(band, seconds, rng, "odd_random")


def tuning_design(machine: Commissioned, plugins: Plugins) -> TuningDesign:
    """Return the design of Q for the machine's faults: the site's retuner, then the proof; it raises `Refused` with the reason that binds.

    The cost has the weights of the running controller where it was designed with any, and those of key ``retune.cost`` before all.
    """
    chosen = machine.config.retune
    settings = stated(chosen.settings)  # bounds hold for design and proof alike

    def design(problem: DetectionProblem, found: DiagnosedFault) -> tuple[Tuning, str, Mapping[str, Any]]:
        cost = loop_cost(problem, {**_own_weights(machine, problem), **chosen.cost})
        Q = plugins.get("retuners", chosen.kind).design(problem, found, cost, chosen.settings)
        tuning, proof = proved_tuning(problem, found, cost, Q, settings)
        return tuning, proof_sentence(proof), {**asdict(proof), "signals": _signals(problem, found, cost, Q)}

    return design


def _own_weights(machine: Commissioned, problem: DetectionProblem) -> dict[str, Any]:
    """Return the weights that the running controller was designed with; a disturbance that is known comes before what was assumed."""
    used = {key: value for key, value in controller_settings(machine).items() if key in WEIGHTS}
    return used if problem.process_cov is None else {key: value for key, value in used.items() if key != "process_weight"}


def proof_sentence(proof: Proof) -> str:
    """Return what was proved in one sentence."""
    return (
        f"stable for every severity of the interval and in the healthy machine; cost {proof.cost_before:.4g} to {proof.cost_after:.4g} "
        f"({100 * proof.reached:.0f} % of the possible), sensitivity {proof.sensitivity_before:.3g} to {proof.sensitivity_after:.3g}"
        + (f"; {proof.bound}" if proof.bound else "")
    )


def _signals(problem: DetectionProblem, found: DiagnosedFault, cost: LoopCost, Q: StateSpace) -> list[dict[str, Any]]:
    """Return the standard deviation of every signal that has a limit, in the middle of the interval without and with Q."""
    model, m, p = signal_model(problem, cost, {found.fault: found.middle}), problem.plant.inputs, problem.plant.outputs
    names = [*(f"u_{n}" for n in problem.input_names or range(m)), *(f"y_{n}" for n in problem.output_names)]
    before, after = (deviations(with_q(model, Q, gain), m, p) for gain in (0.0, 1.0))
    return [{"signal": n, "before": float(a), "after": float(b)} for n, a, b in zip(names, before, after, strict=True)]
