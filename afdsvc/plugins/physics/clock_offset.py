"""Clock offset: the inputs are recorded later than they act."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from afdsvc.api.physics import MOST_AHEAD, MOST_SIGNALS, Coefficient, Hypothesis, Machine, Signal, Size
from afdsvc.plugins.physics.attach import at_input, at_machine

STARTS = (0.5, 1.0, 2.5)  # samples


def read_late(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The inputs ``p[0]`` later, interpolated between samples; ``z`` holds all of one sample, then all of the next."""
    n = len(out)
    early = min(p[0] / dt, len(z) // n - 1.0)
    whole = min(int(early), len(z) // n - 2)
    part = early - whole
    for j in range(n):
        out[j] += (1 - part) * z[n * whole + j] + part * z[n * (whole + 1) + j] - z[j]


class ClockOffset:
    """The clock of the inputs against that of the outputs, and of one input against the others. A machine cannot answer before it is driven."""

    name = "clock_offset"
    summary = "inputs that are recorded later than they act: clocks out of step, or a sample that is read after the answer to it"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis for all inputs, and one per input where there are several."""
        if 0 < len(machine.inputs) <= MOST_SIGNALS // 2:
            yield _late(machine.inputs, machine)
        if len(machine.inputs) > 1:
            yield from (_late([port], machine) for port in machine.inputs)


def _late(ports: Sequence[Size], machine: Machine) -> Hypothesis:
    inputs = [Signal("u", port.index) for port in ports]
    latest = min(MOST_AHEAD, MOST_SIGNALS // len(ports) - 1)
    later = [Signal("u", s.index, a) for a in range(1, latest + 1) for s in inputs]
    parts: dict[str, Any] = {
        "family": "timing", "physics": ClockOffset.name,
        "parameters": [Coefficient("offset", "s", 0.01 * machine.dt, latest * machine.dt, 0.2 * machine.dt)],
        "starts": [(k * machine.dt,) for k in STARTS if k < latest],
        "predicts": "a phase lead proportional to frequency at an unchanged gain: an answer before its cause",
        "refuted_by": "a lead that levels off, or comes with a gain that rises",
    }
    return at_input(ports[0], read_late, later, **parts) if len(ports) == 1 else at_machine("input", read_late, [*inputs, *later], inputs, **parts)
