"""Bursts played into alpha, and the limits of a machine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True)
class Line:
    """One sine in a burst: which alpha input (column), angular frequency [rad/s], amplitude [input unit], phase [rad]."""

    input: int
    omega: float
    amplitude: float
    phase: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Burst:
    """An excitation to be added to alpha.

    ``samples`` counts the whole burst; the first and last ``ramp`` of them rise and fall as a raised cosine, so alpha
    starts and ends at zero with zero slope. ``lines`` describe a multisine; ``waveform`` (shape ``(samples, inputs)``)
    replaces them for anything else. ``settle`` samples after the ramp are meant to be left out of the analysis.
    """

    name: str
    inputs: int
    samples: int
    ramp: int
    lines: tuple[Line, ...] = ()
    waveform: Array | None = None
    settle: int = 0
    purpose: str = "diagnose"
    notes: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.samples < 1 or 2 * self.ramp > self.samples:
            raise BadInput(f"burst '{self.name}': {self.samples} samples cannot hold two ramps of {self.ramp}")
        if self.waveform is not None and self.waveform.shape != (self.samples, self.inputs):
            raise BadInput(f"burst '{self.name}': waveform {self.waveform.shape}; expected {(self.samples, self.inputs)}")
        for line in self.lines:
            if not 0 <= line.input < self.inputs:
                raise BadInput(f"burst '{self.name}': line on input {line.input}; the machine has {self.inputs} inputs")

    def play(self, dt: float) -> Array:
        """Return alpha, shape ``(samples, inputs)``, in the input's unit, including the ramps."""
        alpha = np.zeros((self.samples, self.inputs)) if self.waveform is None else self.waveform.copy()
        t = np.arange(self.samples) * dt
        for line in self.lines:
            alpha[:, line.input] += line.amplitude * np.sin(line.omega * t + line.phase)
        return alpha * self.envelope()[:, None]

    @property
    def content(self) -> tuple[object, ...]:
        """What is played, whatever the burst is called: every burst has a name of its own, most are alike."""
        waveform = b"" if self.waveform is None else self.waveform.tobytes()
        return self.inputs, self.samples, self.ramp, self.settle, self.lines, waveform

    def envelope(self) -> Array:
        """Return the raised-cosine gate, shape ``(samples,)``, between 0 and 1."""
        gate = np.ones(self.samples)
        if self.ramp:
            rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(self.ramp) / self.ramp)
            gate[: self.ramp], gate[self.samples - self.ramp :] = rise, rise[::-1]
        return gate


@dataclass(frozen=True, slots=True, eq=False)
class Limits:
    """What a rig allows, enforced inside the control sample.

    ``output`` and ``input`` are absolute bounds per channel (the machine's units), ``alpha`` per excitation input,
    ``seconds`` the longest burst.
    """

    output: Array
    input: Array
    alpha: Array
    seconds: float = 14.0
