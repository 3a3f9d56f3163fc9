"""A machine's pipeline from blocks to evidence, and the design of its bursts."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from functools import lru_cache, partial

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem, FalseAlarms, Noise
from afdsvc.app import commissioning
from afdsvc.app.commissioning import Commissioned
from afdsvc.diagnosis.pipeline import CalibratedPipeline, Design, ExcitableStream, Pipeline, calibrated
from afdsvc.diagnosis.speed_schedule import SpeedPipeline
from afdsvc.errors import BadInput
from afdsvc.excite.diagnosis_burst import Aim, default_burst, second_burst
from afdsvc.plugins.manager import Plugins
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
        return calibrated(machine.plant, *commissioning.quiet_samples(machine, samples), design)[0]
    if samples:
        return CalibratedPipeline(machine.plant, commissioning.expectation(machine, 0), samples, design)
    return design(_stated_noise(machine), 50)


def _stated_noise(machine: Commissioned) -> Noise:
    if machine.noise is None:
        raise BadInput(f"machine '{machine.config.id}': the noise is unknown; set 'output_sd' or 'calibrate_seconds'")
    return machine.noise


def _design(machine: Commissioned, plugins: Plugins) -> Design:
    def design(noise: Noise, frozen_after: int) -> Pipeline:
        base = commissioning.problem(machine, noise, FalseAlarms())
        expected, redesign = commissioning.expectation(machine, frozen_after), partial(commissioning.detectors, machine, plugins=plugins)
        return Pipeline(base, redesign(base), expected, redesign=redesign)

    return design


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
    """Return the design of the machine's diagnosis burst, computed once for every problem."""

    @lru_cache(maxsize=64)
    def design(problem: DetectionProblem) -> Burst:
        settings, limits = machine.config.bursts, machine.limits
        if limits is None:
            raise BadInput(f"machine '{machine.config.id}' can be watched, not excited")
        return default_burst(problem, limits, settings.seconds, settings.output_amplitude, Aim(severity=settings.severity))

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

    def design(wanted: BurstOrder) -> Burst:
        problem = stream.problem
        if wanted.purpose == "diagnose":
            return diagnosis(problem)
        if wanted.question:
            return second_burst(problem, limits, wanted.question.weights, wanted.question.severity, settings.seconds)
        return commissioning.identification_burst(machine, wanted.purpose, rng)

    return design
