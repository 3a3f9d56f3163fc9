"""Excitations that could be played next: up to which frequency, at which level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.dataset.experiment import Run
from afdsvc.errors import BadInput
from afdsvc.excite.identification_bursts import Band, multisine_burst
from afdsvc.explain.search.machine import bandwidth
from afdsvc.lti.statespace import Array

WIDER = (1.0, 2.0, 4.0)  # upper edge over the present one
LEVELS = (1.0, 1.5, 2.0, 0.5)  # over the present one
TOP = 0.8  # of the Nyquist frequency
SECONDS, PERIODS = 0.5, 5
LINES = 40  # a period holds that many lines of the band, where half a second does not
CREST = 1.8  # peak over rms of the multisines played
SEED = 1  # of detection lines and phases


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A multisine: ``band`` [Hz], ``level`` over the present one, ``peak`` its largest value [input unit]."""

    burst: Burst
    band: tuple[float, float]
    level: float
    peak: float

    @property
    def period(self) -> int:
        """Samples of one period."""
        return int(self.burst.notes["period_samples"])

    @property
    def effort(self) -> float:
        """What orders plans from mild to demanding: power, then bandwidth."""
        return self.level**2 + 0.01 * self.band[1]


def plans(runs: Sequence[Run]) -> list[Plan]:
    """Return multisines on all inputs, about where they are; the first one has the band and level of the recordings.

    An input that never changes its sign may be unable to (a heater, a pump): it stays within the range of the recordings.
    """
    dt, strong = runs[0].dt, np.max([_drive(r).std(0) for r in runs], axis=0)
    if not any(np.ptp(_drive(r), axis=0).any() for r in runs):  # constant inputs have no level to begin from
        return []
    played = np.vstack([_drive(r) for r in runs])
    low, high = played.min(0), played.max(0)
    room = np.where((low < high) & ((low >= 0) | (high <= 0)), (high - low) / 2, np.inf)
    peaks = CREST * np.maximum(strong, 0.1 * float(strong.max()) + 1e-300)
    levels = {float((np.minimum(level * peaks, room) / peaks).max()): np.minimum(level * peaks, room) for level in LEVELS}
    top = min(bandwidth(runs) / (2 * np.pi), TOP / (2 * dt))
    bands = dict.fromkeys((top / LINES, min(w * top, TOP / (2 * dt))) for w in WIDER)
    return [made for band, level in product(bands, levels) if (made := _plan(band, level, levels[level], dt)) is not None]


def _drive(run: Run) -> Array:
    return run.W if run.W is not None and run.commanded else run.U


def _plan(band: tuple[float, float], level: float, peaks: Array, dt: float) -> Plan | None:
    try:
        return Plan(multisine_plan(band, peaks, dt), band, level, float(peaks.max()))
    except BadInput:  # too few lines in the band
        return None


def multisine_plan(band: tuple[float, float], peaks: Array, dt: float) -> Burst:
    """Return an odd multisine with detection lines, five periods, each long enough for the lowest frequency and for `LINES` lines."""
    seconds = PERIODS * max(SECONDS, 1 / band[0], 2 * LINES * dt)
    burst = multisine_burst(Band(band[0], band[1], peaks, dt), seconds, np.random.default_rng(SEED), "odd_random", PERIODS, "next_experiment")
    return replace(burst, purpose="explain")


def as_run(burst: Burst, seen: Run, p: int) -> Run:
    """Return two periods of a burst as a run, one to settle and one to compare; other signals rest at their mean."""
    alpha = np.tile(_period(burst, seen.dt), (2, 1))
    nothing = np.zeros((len(alpha), p))
    return Run(burst.name, seen.dt, 0.0, alpha, nothing, np.tile(seen.AUX.mean(0), (len(alpha), 1)), nothing, seen.aux, W=alpha, commanded=True)


def _period(burst: Burst, dt: float) -> Array:
    """Return one period of a multisine, ``(period, inputs)``: thousands of lines at once by the inverse Fourier transform."""
    n = int(burst.notes["period_samples"])
    spectrum = np.zeros((n // 2 + 1, burst.inputs), dtype=complex)
    for line in burst.lines:
        spectrum[round(line.omega * dt * n / (2 * np.pi)), line.input] += -0.5j * n * line.amplitude * np.exp(1j * line.phase)
    return np.asarray(np.fft.irfft(spectrum, n, axis=0))
