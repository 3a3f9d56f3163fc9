"""Bursts that could be played next: which inputs, up to which frequency, how loud, at which rotor speed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from afdsvc.api.bursts import Burst, Limits
from afdsvc.dataset.experiment import Run
from afdsvc.excite.identification_bursts import Band, multisine_burst
from afdsvc.explain.baseline import Baseline, lower_edge
from afdsvc.explain.locate_tones import speeds
from afdsvc.explain.sizes import bandwidth
from afdsvc.lti.statespace import Array

WIDER = (1.0, 2.0, 4.0, 0.25)  # upper edge over the present one
LEVELS = (1.0, 1.5, 2.0)
FASTER = (1.0, 1.5)
TOP = 0.8  # of the Nyquist frequency
SECONDS, PERIODS = 0.5, 5
CREST = 1.8  # peak over rms of the multisines played


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A burst to consider: the inputs it plays on, ``band`` [Hz], ``level`` over the present one, rotor ``speed`` (None: no rotor).

    ``peak`` is its largest value [input unit], ``effort`` orders plans from mild to demanding, ``period`` counts samples.
    """

    burst: Burst
    inputs: tuple[int, ...]
    band: tuple[float, float]
    level: float
    speed: float | None
    peak: float
    effort: float
    period: int


def plans(base: Baseline, limits: Limits | None, generator: np.random.Generator) -> list[Plan]:
    """Return all plans; the first is the present experiment: all inputs, the present band, level and speed."""
    runs = base.objective.runs
    peaks, dt = _peaks(runs), runs[0].dt
    period = _period(runs)
    low = max(lower_edge(runs) / (2 * np.pi), 1 / (period * dt))
    top = min(bandwidth(runs) / (2 * np.pi), TOP / (2 * dt))
    out = []
    for (wider, band), inputs in product(_bands(low, top, TOP / (2 * dt)), _choices(peaks)):
        if (band[1] - band[0]) * period * dt < 8 * len(inputs):
            continue
        shape = _burst(inputs, peaks, band, period, dt, generator)
        for level, speed in product(LEVELS, _speeds(runs)):
            if _affordable(level, peaks, limits):
                out.append(_plan(shape, inputs, band, level, speed, peaks, period, wider, _speeds(runs)[0]))
    return out


def _bands(low: float, top: float, most: float) -> list[tuple[float, tuple[float, float]]]:
    """Return bands [Hz] with their upper edge over the present one: from the bottom, and above what was excited so far."""
    out = [(w, (low, min(w * top, most))) for w in WIDER if w <= 1 or min(w * top, most) > 1.2 * top]
    return out + [(w, (top, band[1])) for w, band in out if w > 1]


def present(tried: Sequence[Plan]) -> Plan:
    """Return the plan that repeats the present experiment."""
    return tried[0]


def _plan(
    shape: Burst, inputs: tuple[int, ...], band: tuple[float, float], level: float, speed: float | None, peaks: Array,
    period: int, wider: float, usual: float | None,
) -> Plan:
    lines = tuple(type(line)(line.input, line.omega, line.amplitude * level, line.phase) for line in shape.lines)
    burst = Burst(
        "next_experiment", shape.inputs, shape.samples, shape.ramp, lines, settle=shape.settle, purpose="explain",
        notes=dict(shape.notes) | ({} if speed is None else {"speed_rad_s": f"{speed:.6g}"}),
    )
    effort = level**2 * len(inputs) / max(len(peaks), 1) + 0.2 * max(wider - 1, 0) + (0.0 if speed == usual else 1.0)
    peak = float(level * peaks[list(inputs)].max())
    return Plan(burst, inputs, band, level, speed, peak, effort, period)


def _burst(
    inputs: tuple[int, ...], peaks: Array, band: tuple[float, float], period: int, dt: float, generator: np.random.Generator
) -> Burst:
    amplitude = np.where(np.isin(np.arange(len(peaks)), inputs), peaks, 0.0)
    return multisine_burst(
        Band(band[0], band[1], amplitude, dt), PERIODS * period * dt, generator, "odd_random", PERIODS, "next_experiment"
    )


def _choices(peaks: Array) -> Iterator[tuple[int, ...]]:
    everything = tuple(range(len(peaks)))
    yield everything
    if len(everything) > 1:
        yield from ((i,) for i in everything)


def _peaks(runs: Sequence[Run]) -> Array:
    """Return, per input, the peak of a low-crest multisine as strong as the loudest excitation so far, at least a tenth of the
    strongest of all; the first quarter of a recording, where the loop is still settling, does not count."""
    strong = np.max([_drive(r)[len(r) // 4 :].std(0) for r in runs], axis=0)
    return np.asarray(CREST * np.maximum(strong, 0.1 * float(strong.max()) + 1e-300))


def _drive(run: Run) -> Array:
    return run.W if run.W is not None and run.commanded else run.U


def _period(runs: Sequence[Run]) -> int:
    """Return the present period where it is of a useful length, else half a second."""
    usual = round(SECONDS / runs[0].dt)
    own = max(r.period for r in runs)
    return own if usual / 4 <= own <= 4 * usual else max(usual, 256)


def _speeds(runs: Sequence[Run]) -> list[float | None]:
    found = speeds(runs)
    return [max(found) * f for f in FASTER] if found else [None]


def _affordable(level: float, peaks: Array, limits: Limits | None) -> bool:
    return limits is None or bool((level * peaks <= np.asarray(limits.alpha)).all())
