"""One clock for all recordings, as far as a tone from outside tells: recordings start at unknown times, a tone goes on through.

The clock of every run is shifted so that the tone is a cosine of zero phase in the middle of the run at one output; a law that
reads the time then has one phase for all recordings, harmonics included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.explain.objective import Objective, Point
from afdsvc.explain.settle import raw, started
from afdsvc.lti.statespace import Array
from afdsvc.stats.tones import Tone


def reads_time(point: Point) -> bool:
    """Whether an effect of the point depends on the clock."""
    return any(s.kind == "t" for e in point.effects for s in e.hypothesis.reads)


def timeless(point: Point) -> Point:
    """Return the point without the effects that depend on the clock."""
    kept = tuple(e for e in point.effects if not any(s.kind == "t" for s in e.hypothesis.reads))
    return replace(point, effects=kept)


def aligned(objective: Objective, point: Point, runs: Sequence[Run], tone: Tone) -> tuple[Run, ...]:
    """Return the runs with clocks set by the tone in their residuals at a point (its initial states are fitted anew)."""
    if not runs:
        return ()
    there = replace(objective, runs=tuple(runs))
    residuals = raw(there, started(there, timeless(point)))
    return tuple(_set(r, e[:, tone.output], tone.omega) for r, e in zip(runs, residuals, strict=True))


def _set(run: Run, e: Array, omega: float) -> Run:
    n = len(e)
    t = run.dt * (np.arange(n) - n / 2)
    phase = float(np.angle(np.sum(e * np.hanning(n) * np.exp(-1j * omega * t))))
    return replace(run, clock=phase / omega - run.dt * n / 2)
