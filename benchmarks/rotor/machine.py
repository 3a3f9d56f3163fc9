"""The turboexpander as the service runs it: simulated rig, scheduled bursts, the service's own pipeline, faster than real time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.evidence import Evidence
from afdsvc.app import commissioning, ports
from afdsvc.app.commissioning import Commissioned
from afdsvc.app.pipelines import burst_design, pipeline_of
from afdsvc.files.site import MachineSection
from afdsvc.plugins.manager import Plugins, load
from afdsvc.service.clock import FastClock
from afdsvc.service.scheduler import BurstOrder


def machine(plugins: Plugins, faults: dict[str, tuple[float, float]] | None = None, seed: int = 1, **more: Any) -> Commissioned:
    """Return the turboexpander with faults as name to (severity, second); ``driver`` in ``more`` adds to the simulator's."""
    injected = [{"name": n, "severity": s, "at_seconds": t} for n, (s, t) in (faults or {}).items()]
    driver = {"kind": "simulator", "real_time": False, "seed": seed, "faults": injected, **more.pop("driver", {})}
    settings = {"bursts": {"severity": -0.2}, "block": 1000, **more}
    return commissioning.commission(MachineSection(id="expander", plant="amb_turboexpander", driver=driver, **settings), plugins)


@dataclass
class Run:
    """What came of a run: evidence, findings in words, the largest displacement [um], the bursts played."""

    evidence: list[Evidence] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    peak: float = 0.0
    bursts: list[Burst] = field(default_factory=list)


def run(parts: Commissioned, plugins: Plugins, plan: Sequence[float | str], burst: Burst | None = None) -> Run:
    """Run the machine: a number is seconds of quiet, ``"burst"`` a diagnosis burst for the speed it has then."""
    port, stream = ports.open_port(parts, "s", FastClock(), plugins), pipeline_of(parts, plugins)
    design, out = (lambda _: burst) if burst else burst_design(parts, stream), Run()

    def take() -> int:
        block = port.read()
        out.peak = max(out.peak, float(np.abs(block.role("y")).max()))
        outcome = stream.step(block)
        out.evidence += outcome.evidence
        out.said += [f.message for f in outcome.findings]
        return len(block)

    for item in plan:
        if item == "burst":
            made = design(BurstOrder("study"))
            stream.announce(made)
            out.bursts.append(made)
            with port.arm(parts.limits) as drive:
                drive.play(made)
                while drive.playing:
                    take()
            take()
        else:
            done = 0
            while done < float(item) / port.dt:
                done += take()
    return out


def plugins() -> Plugins:
    """Return everything installed."""
    return load()
