"""What watching costs, counted: calls and memory per block, for any number of hypotheses and length of a burst."""

from __future__ import annotations

import gc
import sys
import tracemalloc
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import FrameType

import numpy as np

from afdsvc.api.detection import DetectionProblem, Detector, ResidualBlock
from afdsvc.lti.lft import FaultDirection, augment


def many_faults(problem: DetectionProblem, count: int) -> DetectionProblem:
    """Return the machine with ``count`` gain faults, each on its own mixture of the actuators."""
    g = problem.plant
    rng, directions = np.random.default_rng(0), []
    for k in range(count):
        mix = rng.normal(size=(g.inputs, 1))
        mix /= np.linalg.norm(mix)
        directions.append(FaultDirection(f"mixture_{k}", g.B @ mix, g.D @ mix, np.zeros((1, g.order)), mix.T, np.zeros((1, 1))))
    return replace(problem, augmented=augment(g, directions))


@dataclass(frozen=True, slots=True)
class Work:
    """What one block costs: calls of functions, Python's and built-in ones, and the largest memory [bytes] taken meanwhile."""

    calls: int
    memory: int


def work(detector: Detector, blocks: Sequence[ResidualBlock]) -> list[Work]:
    """Return what every block of a record costs, counted and not timed: the same on every computer, whatever else it does.

    A first pass, uncounted, lets be loaded and compiled what is so on first use. Leave the block in which the burst ends out to count
    streaming alone: the decision comes with it. What goes on inside compiled functions is not counted, but by the memory it takes.
    """
    state, found = detector.start(), []
    for block in blocks:
        state, _ = detector.step(state, block)
    state = detector.start()
    gc.disable()  # finalisers of what earlier work left would be counted, too
    tracemalloc.start()
    try:
        for block in blocks:
            tracemalloc.reset_peak()
            before, calls = tracemalloc.get_traced_memory()[0], _Calls()
            sys.setprofile(calls)
            try:
                state, _ = detector.step(state, block)
            finally:
                sys.setprofile(None)
            found.append(Work(calls.count, tracemalloc.get_traced_memory()[1] - before))
    finally:
        tracemalloc.stop()
        gc.enable()
    return found


class _Calls:
    """A profile function that counts calls."""

    count = 0

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        self.count += event in ("call", "c_call")
