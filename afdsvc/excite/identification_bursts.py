"""Bursts for identification, which excite many frequencies at once.

- random binary: flat up to its switching rate, crest factor one, the most power an amplitude limit allows;
- multisine: exactly the chosen lines; with odd lines only, and some of those left out, what comes back at the even and
  at the left-out lines is the machine's nonlinearity, separated from noise (Pintelon and Schoukens, System
  Identification, 2012, chapter 4); several inputs get lines of their own (zippered), so one burst separates their effects
  apart;
- sweep: one frequency at a time, for people who want to listen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from afdsvc.api.bursts import Burst, Line
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array

IntArray = NDArray[np.intp]
Grid = Literal["full", "odd", "odd_random"]


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """Where to excite: from ``low`` to ``high`` [Hz], with at most ``amplitude (m,)`` on every input, at ``dt`` [s]."""

    low: float
    high: float
    amplitude: Array
    dt: float

    def __post_init__(self) -> None:
        if not 0 < self.low < self.high <= 0.5 / self.dt:
            raise BadInput(
                f"band {self.low:.6g} to {self.high:.6g} Hz; expected 0 < low < high <= {0.5 / self.dt:.6g} Hz (half the "
                "rate)"
            )
        if not (np.asarray(self.amplitude) > 0).any():
            raise BadInput("every amplitude is zero or negative; expected a positive one for at least one input")


def random_binary_burst(band: Band, seconds: float, rng: np.random.Generator, name: str = "identify_binary") -> Burst:
    """Return a random binary burst: each input flips by a coin every ``1 / (2.5 high)`` seconds, independently.

    Its spectrum is down by 3 dB near ``high``; ``low`` is ignored (the spectrum reaches down to 1/seconds).
    """
    samples, m = _samples(seconds, band), len(band.amplitude)
    hold = max(1, round(1 / (2.5 * band.high * band.dt)))
    coins = rng.integers(0, 2, size=(-(-samples // hold), m)) * 2.0 - 1.0
    waveform = np.repeat(coins, hold, axis=0)[:samples] * np.asarray(band.amplitude)
    notes = {"hold_samples": str(hold)}
    return Burst(
        name, m, samples, _ramp(samples), waveform=waveform, settle=_ramp(samples), purpose="identify", notes=notes
    )


def multisine_burst(
    band: Band,
    seconds: float,
    rng: np.random.Generator,
    grid: Grid = "full",
    periods: int = 4,
    name: str = "identify_multisine",
) -> Burst:
    """Return a multisine with a flat spectrum: ``periods`` periods that fill ``seconds``, phases of low crest factor.

    ``grid`` "full" uses every harmonic of the period, "odd" the odd ones, "odd_random" the odd ones with one of every
    four consecutive ones left out at random as a detection line. Inputs take turns line by line. The peak of every
    input is its amplitude of the band. Raises `BadInput` when the band holds too few lines for the inputs.
    """
    if grid not in ("full", "odd", "odd_random"):
        raise BadInput(f"grid '{grid}'; expected full, odd or odd_random")
    period = _samples(seconds / periods, band)
    excited, _ = grid_lines(band, period, grid, rng)
    amplitudes = np.asarray(band.amplitude, dtype=np.float64)
    active = np.flatnonzero(amplitudes > 0)
    if len(excited) < 2 * len(active):
        raise BadInput(
            f"a period of {period * band.dt:.4g} s puts {len(excited)} lines between {band.low:.6g} and "
            f"{band.high:.6g} Hz; expected at least "
            f"{2 * len(active)}: play longer or widen the band"
        )
    lines = []
    for turn, column in enumerate(active):
        own = excited[turn :: len(active)]
        phases = _low_crest_phases(own, period, rng)
        peak = float(np.abs(_waveform(own, phases, period)).max())
        step = 2 * np.pi / (period * band.dt)
        lines += [
            Line(int(column), float(k * step), float(amplitudes[column] / peak), float(f))
            for k, f in zip(own, phases, strict=True)
        ]
    samples = period * periods
    notes = {"period_samples": str(period), "grid": grid}
    return Burst(
        name,
        len(amplitudes),
        samples,
        min(period // 2, _ramp(samples)),
        tuple(lines),
        settle=period,
        purpose="identify",
        notes=notes,
    )


def sweep_burst(band: Band, seconds: float, logarithmic: bool = True, name: str = "identify_sweep") -> Burst:
    """Return a sweep from low to high on one input after the other, each for an equal share of the time."""
    samples, m = _samples(seconds, band), len(band.amplitude)
    waveform = np.zeros((samples, m))
    share = samples // m
    t = np.arange(share) * band.dt
    if logarithmic:
        rate = np.log(band.high / band.low) / t[-1]
        phase = 2 * np.pi * band.low * np.expm1(rate * t) / rate
    else:
        phase = 2 * np.pi * (band.low * t + 0.5 * (band.high - band.low) / t[-1] * t**2)
    gate = _gate(share)
    for column in range(m):
        waveform[column * share : (column + 1) * share, column] = band.amplitude[column] * np.sin(phase) * gate
    return Burst(name, m, samples, _ramp(samples), waveform=waveform, purpose="identify")


def grid_lines(band: Band, period: int, grid: Grid, rng: np.random.Generator) -> tuple[IntArray, IntArray]:
    """Return the harmonics of a period that are excited, and the odd ones in the band left out as detection lines."""
    step = 1 / (period * band.dt)
    harmonics = np.arange(
        max(1, int(np.ceil(band.low / step))), int(np.floor(min(band.high / step, (period - 1) // 2))) + 1
    )
    if grid == "full":
        return harmonics, harmonics[:0]
    odd = harmonics[harmonics % 2 == 1]
    if grid == "odd":
        return odd, odd[:0]
    groups = [odd[i : i + 4] for i in range(0, len(odd) - 3, 4)]
    left_out = np.asarray([g[rng.integers(4)] for g in groups], dtype=odd.dtype)
    return np.setdiff1d(odd, left_out), left_out


def distortion(y: Array, burst: Burst, excited: Sequence[int]) -> dict[str, float]:
    """Return the power at excited, even and left-out odd harmonics and of the noise between periods, as shares of the
    whole.

    ``y`` is one output over the burst, steady state; ``excited`` the harmonics played on any input. An even share well
    above ``noise`` means an even nonlinearity (a quadratic stiffness, a one-sided stop), an odd one friction,
    hardening, ....
    """
    period = int(burst.notes["period_samples"])
    whole = (min(len(y), burst.samples - burst.ramp) - burst.settle) // period
    if whole < 2:
        raise BadInput(f"{len(y)} samples hold fewer than two settled periods of {period}; play more periods")
    table = np.fft.rfft(y[burst.settle : burst.settle + whole * period].reshape(whole, period), axis=1)
    mean, power = table.mean(axis=0), np.abs(table.mean(axis=0)) ** 2
    noise = (np.abs(table - mean) ** 2).sum(axis=0) / (whole - 1) / whole
    k = np.arange(len(mean))
    played = np.isin(k, excited)
    top = k <= max(excited)
    parts = {"excited": played, "even": (k % 2 == 0) & (k > 0) & ~played & top, "odd": (k % 2 == 1) & ~played & top}
    total = float(power[1:].sum())
    return {name: float(power[mask].sum()) / total for name, mask in parts.items()} | {
        f"noise_{name}": float(noise[mask].sum()) / total for name, mask in parts.items()
    }


def _samples(seconds: float, band: Band) -> int:
    samples = round(seconds / band.dt)
    if samples < 16:
        raise BadInput(f"{seconds:.4g} s are {samples} samples; expected at least 16")
    return samples


def _ramp(samples: int) -> int:
    return samples // 40


def _gate(samples: int) -> Array:
    """Return a raised-cosine gate, so that a sweep enters and leaves an input smoothly."""
    return Burst("gate", 1, samples, max(1, samples // 40)).envelope()


def _waveform(harmonics: IntArray, phases: Array, period: int) -> Array:
    """Return one period of the sum of unit sines."""
    spectrum = np.zeros(period // 2 + 1, dtype=np.complex128)
    spectrum[harmonics] = np.exp(1j * (phases - np.pi / 2)) * period / 2
    return np.asarray(np.fft.irfft(spectrum, period))


def _low_crest_phases(harmonics: IntArray, period: int, rng: np.random.Generator, rounds: int = 60) -> Array:
    """Return phases of low crest factor by clipping in time and restoring the spectrum (Van der Ouderaa et al.,
    1988)."""
    phases = rng.uniform(0, 2 * np.pi, len(harmonics))
    best, best_peak = phases, np.inf
    for round_ in range(rounds):
        x = _waveform(harmonics, phases, period)
        peak = float(np.abs(x).max())
        if peak < best_peak:
            best, best_peak = phases, peak
        limit = peak * (0.75 + 0.2 * round_ / rounds)
        spectrum = np.fft.rfft(np.clip(x, -limit, limit))[harmonics]
        phases = np.angle(spectrum) + np.pi / 2
    return np.mod(best, 2 * np.pi)
