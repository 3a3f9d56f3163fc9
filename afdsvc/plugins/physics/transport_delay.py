"""Transport delay: what is commanded, or measured, arrives later, at once or spread over a time."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_input, at_output

LONGEST = 400  # samples that are remembered
STARTS = (0.5, 1.5, 5.0, 12.0, 30.0, 75.0, 180.0)  # samples


def delay(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The value ``p[0]`` ago, interpolated between samples, and where there is a ``p[1]`` through a lag of that time constant (its mean over the step).

    ``m`` holds what the lag has reached, a count, and a ring of the last samples.
    """
    size = len(m) - 2
    if m[1] == 0.0:
        for i in range(size):
            m[2 + i] = z[0]
    k = int(m[1])
    m[2 + k % size] = z[0]
    m[1] = k + 1.0
    late = min(p[0] / dt, size - 2.0)
    whole = int(math.floor(late))
    part = late - whole
    u = (1 - part) * m[2 + (k - whole) % size] + part * m[2 + (k - whole - 1) % size]
    out[0] += u - z[0]
    if len(p) > 1:
        decay = math.exp(-dt / p[1])
        rest = m[0] - u
        out[0] += rest * (1 - decay) * p[1] / dt
        m[0] = u + rest * decay


def average(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The mean over the last ``p[0]``, of values held over the step.

    ``m`` holds the integral, a count, and a ring of the integral in the middle of the last steps.
    """
    size = len(m) - 2
    if m[1] == 0.0:
        for i in range(size):
            m[2 + (-i) % size] = (0.5 - i) * z[0] * dt
    k = int(m[1])
    middle = m[0] + 0.5 * z[0] * dt
    m[0], m[1], m[2 + k % size] = m[0] + z[0] * dt, k + 1.0, middle
    late = min(p[0] / dt, size - 2.0)
    whole = int(math.floor(late))
    part = late - whole
    before = (1 - part) * m[2 + (k - whole) % size] + part * m[2 + (k - whole - 1) % size]
    out[0] += (middle - before) / (late * dt) - z[0]


class TransportDelay:
    """A pure delay at every input and every output, at inputs also before a lag, as processes are described that carry heat or matter; and the mean over
    a window, as of a flow through a tube, of counted pulses and of digital filters."""

    name = "transport_delay"
    summary = "a pure delay between command and action, or between motion and reading, or the mean over the last moments"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return a delay and a mean over a window for every input and output, and at inputs a delay with a lag behind it."""
        longest = max(8 * machine.dt, min(LONGEST * machine.dt, machine.duration / 20))
        parts: dict[str, Any] = {
            "physics": self.name, "family": "timing",
            "parameters": [Coefficient("delay", "s", 0.01 * machine.dt, longest, 0.2 * machine.dt)],
            "starts": [(k * machine.dt,) for k in STARTS if k * machine.dt < longest],
            "predicts": "phase lag proportional to frequency at an unchanged gain",
            "refuted_by": "a gain that changes with the phase, or a phase lag that levels off",
        }
        ring, span = int(4 * longest / machine.dt) + 5, 1 / machine.bandwidth
        lag = Coefficient("time constant", "s", 1e-3 * span, 300 * span, 0.05 * span)
        both: dict[str, Any] = {
            **parts, "parameters": [*parts["parameters"], lag], "starts": [(d, tau) for (d,) in parts["starts"][1::2] for tau in (span, 10 * span)],
            "notes": {"variant": "with a lag", "of": ""}, "unsettled": 1,
            "predicts": "an answer to a step that begins late, then approaches its end exponentially", "refuted_by": "an answer that overshoots, or begins at once",
        }
        window: dict[str, Any] = {
            **parts, "parameters": [Coefficient("window", "s", machine.dt, longest, 0.2 * machine.dt)], "starts": [(2 * d,) for (d,) in parts["starts"][1:] if 2 * d < longest],
            "notes": {"variant": "mean over a window", "of": ""},
            "predicts": "an answer to a step that rises evenly and then ends", "refuted_by": "a gain that does not fall towards high frequency",
        }
        for port in machine.inputs:
            for law, shape in ((delay, parts), (delay, both), (average, window)):
                yield at_input(port, law, memory=ring, substeps=4, **shape)
        for port in machine.outputs:
            for law, shape in ((delay, parts), (average, window)):
                yield at_output(port, law, memory=int(longest / machine.dt) + 5, **shape)
