"""What watching costs: seconds of processor time per sample, for any number of hypotheses and length of a burst."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

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


def cost_per_sample(
    detector: Detector, blocks: Sequence[ResidualBlock], timer: Callable[[], float], repeats: int = 5
) -> float:
    """Return seconds per sample, the best of several passes; ``timer`` is, for example, ``time.process_time``.

    Leave the block in which the burst ends out to measure streaming alone: the decision comes with it.
    """
    best, samples = float("inf"), sum(len(b) for b in blocks)
    for _ in range(repeats):
        state, began = detector.start(), timer()
        for block in blocks:
            state, _ = detector.step(state, block)
        best = min(best, timer() - began)
    return best / samples
