"""Hypotheses that these recordings cannot separate, whatever is fitted, and what would have to be recorded or played to do so."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from afdsvc.api.model import Model
from afdsvc.dataset.excitation import input_source
from afdsvc.dataset.experiment import Run
from afdsvc.dataset.periods import speeds
from afdsvc.dataset.sample_checks import Finding
from afdsvc.explain.search.machine import bandwidth

SHORT = 0.12  # phase [rad] by which one sample of delay differs from one of lag, third order; see `_timing`
ROTATING = ("speed", "angle")


def ambiguities(model: Model, runs: Sequence[Run]) -> Iterator[Finding]:
    """Yield what cannot be separated."""
    yield from _levels(model, runs)
    yield from _timing(runs)
    yield from _rotation(runs)
    yield from _still(runs)


def _levels(model: Model, runs: Sequence[Run]) -> Iterator[Finding]:
    drives = [p for i in range(len(model.inputs)) if any((p := input_source(runs, i)).rms)]
    if drives and max(p.levels for p in drives) < 2 and all(p.periods > 1 for p in drives):
        yield Finding(
            "warning", "ambiguity",
            "all recordings have one level: clearance and cubic stiffness, friction and a dead zone may fit alike; "
            "a second level, half or twice as high, would separate them",
        )


def _timing(runs: Sequence[Run]) -> Iterator[Finding]:
    """A lag of one sample and a delay of one differ in phase by (omega dt)^3 / 3 and in gain by (omega dt)^2 / 2."""
    turn = bandwidth(runs) * runs[0].dt
    if turn**2 / 2 < SHORT:
        yield Finding(
            "warning", "ambiguity",
            f"the excitation ends at {bandwidth(runs) / (2 * np.pi):.4g} Hz: a delay and a lag of a sample ({1e3 * runs[0].dt:.3g} ms) fit "
            f"alike below {np.sqrt(2 * SHORT) / (2 * np.pi * runs[0].dt):.4g} Hz; higher lines would separate them",
        )


def _rotation(runs: Sequence[Run]) -> Iterator[Finding]:
    names = runs[0].aux
    if "speed" in names and "angle" not in names:
        yield Finding("warning", "ambiguity", "the rotor's speed is recorded but not its angle: unbalance and runout can only be seen as tones")
    turning = speeds(runs)
    if turning and max(turning) < 1.05 * min(turning):
        yield Finding(
            "warning", "ambiguity",
            "all recordings are at one rotor speed: unbalance, which grows with the speed squared, and runout, which does not, may fit "
            "alike; a second speed would separate them",
        )


def _still(runs: Sequence[Run]) -> Iterator[Finding]:
    for k, name in enumerate(runs[0].aux):
        values = np.concatenate([r.AUX[:, k] for r in runs])
        if name not in ROTATING and np.ptp(values) <= 1e-6 * max(float(np.abs(values).max()), 1e-300):
            yield Finding("warning", "ambiguity", f"aux_{name} does not change: nothing can be found to follow it")
