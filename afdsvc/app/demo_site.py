"""The site of a demonstration: what is simulated, which faults it gets. Light to import, so that `afdsvc demo` says at once what it prepares."""

from __future__ import annotations

import re
import socket
from dataclasses import dataclass
from pathlib import Path

from afdsvc.errors import BadInput
from afdsvc.plants.registry import plant as plant_by_name

DISTURBANCE = 0.1  # of the inputs, in their unit, of a machine that is to be healed
_FAULT = re.compile(r"(?P<name>[a-z0-9_]+)=(?P<severity>[-+0-9.eE]+)(@(?P<at>[0-9.]+))?")


@dataclass(frozen=True, slots=True)
class DemoOptions:
    """What is demonstrated: plant, controller, rotor speed [rpm] (None: the plant's own), faults (name, severity, second), ...

    With ``heal`` the inputs are disturbed, and the Q that the service proposes for the fault is accepted. ``console``: ``host:port`` of
    the page that shows the machine while it runs.
    """

    plant: str = "gas_bearing"
    controller: str = "lqg"
    rpm: int | None = None
    faults: tuple[tuple[str, float, float], ...] = (("horizontal_actuator", -0.5, 12.0),)
    seconds: float = 30.0
    seed: int = 1
    out: Path = Path("recordings")
    every: float = 5.0
    heal: bool = False
    console: str = ""


def first_fault(plant: str, heal: bool = False) -> str:
    """Return the default fault of a demonstration of this plant, with ``heal`` a sensor's, which costs the loop most; may raise `BadInput`."""
    known = plant_by_name(plant)
    names = (*known.usual_faults, *known.fault_sites)
    return next((name for name in names if heal and name.endswith("sensor")), names[0])


def parse_fault(text: str) -> tuple[str, float, float]:
    """Return (name, severity, second) of ``NAME=-0.5@12``; raises `BadInput` saying what was found and what was expected."""
    match = _FAULT.fullmatch(text.strip())
    if match is None:
        raise BadInput(f"--fault '{text}': expected NAME=SEVERITY@SECONDS, for example horizontal_actuator=-0.5@12")
    try:
        severity, at = float(match["severity"]), float(match["at"] or 0)
    except ValueError:
        raise BadInput(f"--fault '{text}': '{match['severity']}' is not a number; expected a severity like -0.5") from None
    if not -1 <= severity <= 0:
        raise BadInput(f"--fault '{text}': severity {severity:g}; expected a number from 0 (healthy) to -1 (total loss)")
    return match["name"], severity, at


def site_text(options: DemoOptions, port: int) -> str:
    """Return the site file of the demonstration."""
    faults = ", ".join(f'{{name = "{n}", severity = {s!r}, at_seconds = {t!r}}}' for n, s, t in options.faults)
    rpm = "" if options.rpm is None else f"rpm = {options.rpm}"
    disturbed = f"input_sd = {[DISTURBANCE] * len(plant_by_name(options.plant).inputs)}" if options.heal else ""
    settings = "settings = {gain = 0.2}" if options.controller == "proportional" else "settings = {}"
    return f"""# Written by `afdsvc demo`: one simulated machine, zenoh on loopback.
site = "demo"

[transport]
listen = ["tcp/127.0.0.1:{port}"]

[recording]
folder = "{options.out.resolve().as_posix()}"

[review]
rerun = "file"

[[machines]]
id = "bearing"
plant = "{options.plant}"
options = {{{rpm}}}
{disturbed}
driver = {{kind = "simulator", real_time = true, seed = {options.seed}, faults = [{faults}]}}
controller = {{kind = "{options.controller}", {settings}}}
bursts = {{every_seconds = {options.every!r}, jitter_seconds = 0.2, first_after_seconds = 2.0}}
"""


def free_port() -> int:
    """Return a free loopback port."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])
