"""Rehearsal: a simulated burst is judged, so that everything designed once per burst exists before the first real one.

Designing what a detector looks for takes tenths of a second for each machine, loading compiled code seconds for the first. The
worker that judges all machines would stand still meanwhile.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.signals import Block, of_role
from afdsvc.detect.features.innovations import ResidualFilter
from afdsvc.diagnosis.pipeline import LONGEST_SETTLING, Pipeline

log = logging.getLogger(__name__)
QUIET = 500  # samples besides those in which the filters settle


def warm_up(pipeline: Pipeline, burst: Burst) -> None:
    """Let a twin of the pipeline judge noise with a burst in it; the pipeline itself is not touched."""
    twin = Pipeline(pipeline.problem, pipeline.detectors, pipeline.expected)
    twin.announce(replace(burst, name="rehearsal"))
    for block in _blocks(twin, burst):
        twin.step(block)


def _blocks(twin: Pipeline, burst: Burst) -> Iterator[Block]:
    expected, rng = twin.expected, np.random.default_rng(0)
    sd = np.sqrt(np.diag(twin.problem.covariance))
    k0 = 0
    settling = min(ResidualFilter(twin.problem.innovations).settling(1e-3), LONGEST_SETTLING)
    for samples, name in ((settling + QUIET, ""), (burst.samples, "rehearsal"), (QUIET, "")):
        values = rng.standard_normal((samples, len(expected.channels)))
        values[:, of_role(expected.channels, "y")] *= sd
        alpha = of_role(expected.channels, "alpha") or of_role(expected.channels, "ref")
        values[:, alpha] = burst.play(expected.dt)[:, : len(alpha)] if name else 0.0
        yield Block(twin.problem.machine, "rehearsal", 0, k0, expected.dt, 0, expected.channels, values, name)
        k0 += samples


class WarmUp:
    """Rehearses one machine after the other in a thread, beside the service that already runs; `close` ends it early."""

    def __init__(self, pairs: Iterable[tuple[Pipeline, Burst]]) -> None:
        self._pairs = list(pairs)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="rehearsals", daemon=True)

    def start(self) -> None:
        """Rehearse the first machine at once, the others meanwhile."""
        for pair in self._pairs[:1]:
            self._one(*pair)
        self._thread.start()

    def close(self, seconds: float = 1.0) -> None:
        """End after the machine at hand."""
        self._stop.set()
        self._thread.join(seconds)

    def _work(self) -> None:
        for pipeline, burst in self._pairs[1:]:
            if self._stop.is_set():
                return
            self._one(pipeline, burst)

    def _one(self, pipeline: Pipeline, burst: Burst) -> None:
        try:
            warm_up(pipeline, burst)
        except Exception:
            log.exception("machine '%s': its burst could not be rehearsed", pipeline.problem.machine)
