"""Excitation of the recordings: inputs, band, spectral lines, levels and periods, and what they leave ambiguous."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from afdsvc.api.model import Model
from afdsvc.dataset.experiment import Run
from afdsvc.dataset.periods import fold
from afdsvc.dataset.sample_checks import CheckFinding
from afdsvc.dataset.units import with_unit
from afdsvc.lti.statespace import Array

LEVELS_APART = 1.2
SINE = "one frequency"  # the topic of an input that is excited at one or two frequencies only
LEFT_OVER = 0.02  # of the input's rms: what reconstructing the loop may leave where nothing was added
SAME_LINE = 1.02  # ratio of the frequencies of two recordings up to which they count as one
EXCITED = 0.1  # amplitude of a line over the largest from which it counts as played


@dataclass(frozen=True, slots=True)
class InputSource:
    """What drove one input (or followed a reference) over all recordings: rms per recording, and of the loudest that holds more than two lines, else
    of all together: lines, band [Hz], whether only odd lines are in it, periods (1: it does not repeat)."""

    rms: tuple[float, ...]
    lines: int
    band: tuple[float, float]
    odd: bool
    periods: int

    @property
    def levels(self) -> int:
        """How many levels that differ by more than a fifth."""
        found: list[float] = []
        for level in sorted(x for x in self.rms if x > 0):
            if not found or level > LEVELS_APART * found[-1]:
                found.append(level)
        return len(found)


def check_excitation(model: Model, runs: Sequence[Run]) -> Iterator[CheckFinding]:
    """Yield one finding per input, and what one frequency alone leaves open."""
    for i, v in enumerate(model.inputs):
        p = input_source(runs, i)
        if not any(p.rms) and not all(only_noise(r, i) for r in runs):
            levels = ", ".join(f"{r.U[:, i].mean():.3g}" for r in runs)
            yield CheckFinding("ok", "inputs", f"input {v.name}: constant in every recording ({with_unit(levels, v.unit)}); its effect shows in how the outputs settle")
        elif not any(p.rms):
            yield CheckFinding("warning", "inputs", f"input {v.name} is not excited: its effect cannot be distinguished from noise")
        elif p.lines <= 2 and p.periods > 1:
            sines = f"one sine ({p.band[0]:.4g}" if p.lines == 1 else f"two sines ({p.band[0]:.4g} and {p.band[1]:.4g}"
            yield CheckFinding(
                "warning", SINE,
                f"input {v.name} is excited by {sines} Hz) only: delay, lag, "
                "gain, stiffness and damping cannot be separated, nor friction and a dead zone; a multisine would "
                "separate them",
            )
        else:
            yield CheckFinding("ok", "inputs", _described(v.name, v.unit, p))


def _described(name: str, unit: str, p: InputSource) -> str:
    grid = ", odd ones only" if p.odd else ""
    what = f"{p.lines} lines from {p.band[0]:.4g} to {p.band[1]:.4g} Hz{grid}, {p.periods} periods" if p.periods > 1 else (
        f"a non-periodic excitation, mainly from {p.band[0]:.4g} to {p.band[1]:.4g} Hz"
    )
    levels = ", ".join(f"{x:.3g}" for x in p.rms)
    return f"input {name}: {what}, rms {with_unit(levels, unit)}"


def input_source(runs: Sequence[Run], i: int) -> InputSource:
    """Return what drove input ``i``: what was added to the controller's output, the reference, or the input itself."""
    signals = [_driver(r, i) for r in runs]
    rms = tuple(float(s.std()) for s in signals)
    top = max(rms)
    if top == 0:
        return InputSource(rms, 0, (0.0, 0.0), False, 0)
    rms = tuple(x if x > 1e-6 * top else 0.0 for x in rms)
    spectra = [(x, *_spectrum(r, s)) for x, r, s in zip(rms, runs, signals, strict=True) if x]
    _, lines, band, odd, periods = max(spectra, key=lambda s: (s[1] > 2 or s[-1] == 1, s[0]))
    if lines <= 2 and periods > 1:
        edges = sorted({edge for _, _, band, _, _ in spectra for edge in band})
        lines, band = 1 + sum(b > SAME_LINE * a for a, b in pairwise(edges)), (edges[0], edges[-1])
    return InputSource(rms, lines, band, odd, periods)


def only_noise(run: Run, i: int) -> bool:
    """Whether a controller feeds nothing but noise through input ``i``; also an input that is zero."""
    return not _driver(run, i).any() and (run.commanded or not run.U[:, i].any())


def _driver(run: Run, i: int) -> Array:
    """Return what moves the input by intent; zeros where only noise comes back through a controller."""
    u = run.U[:, i] - run.U[:, i].mean()
    if not run.commanded or run.W is None:
        return np.asarray(u)
    added = run.W[:, i] - run.W[:, i].mean()
    if added.std() > LEFT_OVER * u.std():
        return np.asarray(added)
    return np.asarray(u if np.ptp(run.REF, axis=0).max(initial=0.0) > 0 else 0 * u)


def _spectrum(run: Run, x: Array) -> tuple[int, tuple[float, float], bool, int]:
    folded = fold(run, x[:, None])
    if folded is None:
        power = np.abs(np.fft.rfft(x)) ** 2
        share = np.cumsum(power) / max(float(power.sum()), 1e-300)
        low, high = np.searchsorted(share, [0.01, 0.99])
        step = 1 / (len(x) * run.dt)
        return int(high - low + 1), (low * step, high * step), False, 1
    size = np.abs(np.fft.rfft(folded.mean(0)[:, 0]))[1:]
    excited = np.flatnonzero(size > EXCITED * max(float(size.max()), 1e-300)) + 1
    step = 1 / (run.period * run.dt)
    odd = bool(len(excited) > 2 and (excited % 2 == 1).all())
    return len(excited), (excited[0] * step, excited[-1] * step), odd, len(run) // run.period
