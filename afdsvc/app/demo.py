"""`afdsvc demo`: a simulated machine in a second process, bursts, a fault, and a comparison of truth and result."""

from __future__ import annotations

import contextlib
import re
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from afdsvc.app.diagnose import diagnose_recordings
from afdsvc.app.serve import serving
from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.files.site import Site, read_site
from afdsvc.plants.registry import plant as plant_by_name
from afdsvc.service.hub import Hub

_FAULT = re.compile(r"(?P<name>[a-z0-9_]+)=(?P<severity>[-+0-9.eE]+)(@(?P<at>[0-9.]+))?")


@dataclass(frozen=True, slots=True)
class DemoOptions:
    """What is demonstrated: plant, controller, rotor speed [rpm] (None: the plant's own), faults (name, severity, second), ..."""

    plant: str = "gas_bearing"
    controller: str = "lqg"
    rpm: int | None = None
    faults: tuple[tuple[str, float, float], ...] = (("horizontal_actuator", -0.5, 12.0),)
    seconds: float = 30.0
    seed: int = 1
    out: Path = Path("recordings")
    every: float = 5.0


def first_fault(plant: str) -> str:
    """Return the default fault of a demonstration of this plant; raises `BadInput` without such a plant."""
    known = plant_by_name(plant)
    return next(iter((*known.usual_faults, *known.fault_sites)))


def parse_fault(text: str) -> tuple[str, float, float]:
    """Return (name, severity, second) of ``NAME=-0.5@12``; raises `BadInput` saying what was found and what was expected."""
    match = _FAULT.fullmatch(text.strip())
    if match is None:
        raise BadInput(f"--fault '{text}': expected NAME=SEVERITY@SECONDS, for example horizontal_actuator=-0.5@12")
    try:
        severity, at = float(match["severity"]), float(match["at"] or 0)
    except ValueError:
        raise BadInput(f"--fault '{text}': '{match['severity']}' is no number; expected a severity like -0.5") from None
    if not -1 <= severity <= 0:
        raise BadInput(f"--fault '{text}': severity {severity:g}; expected a number from 0 (healthy) to -1 (total loss)")
    return match["name"], severity, at


def site_text(options: DemoOptions, port: int) -> str:
    """Return the site file of the demonstration."""
    faults = ", ".join(f'{{name = "{n}", severity = {s!r}, at_seconds = {t!r}}}' for n, s, t in options.faults)
    rpm = "" if options.rpm is None else f"rpm = {options.rpm}"
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
driver = {{kind = "simulator", real_time = true, seed = {options.seed}, faults = [{faults}]}}
controller = {{kind = "{options.controller}", {settings}}}
bursts = {{every_seconds = {options.every!r}, jitter_seconds = 0.2, first_after_seconds = 2.0}}
"""


def run_demo(options: DemoOptions, tell: Callable[[float, Hub], None]) -> dict[str, Any]:
    """Run the demonstration; ``tell(done seconds, hub)`` is called several times a second. Returns the JSON document."""
    with tempfile.TemporaryDirectory(prefix="afdsvc-demo-") as folder:
        path = Path(folder) / "site.toml"
        path.write_text(site_text(options, free_port()), encoding="utf-8")
        site = read_site(path)
        with serving(site) as hub, rig_process(path, "bearing", options.seconds) as rig:
            _wait(hub, rig, path.parent / "rig.log", options.seconds, tell)
            files = hub.files()
    return _document(options, site, files)


@contextlib.contextmanager
def rig_process(site: Path, machine: str, seconds: float) -> Iterator[subprocess.Popen[bytes]]:
    """Run ``afdsvc rig`` as a process of its own; it is ended when the block ends."""
    command = [sys.executable, "-m", "afdsvc", "rig", str(site), "--machine", machine, "--seconds", str(seconds)]
    with (site.parent / "rig.log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _wait(hub: Hub, rig: subprocess.Popen[bytes], log: Path, seconds: float, tell: Callable[[float, Hub], None]) -> None:
    """Wait until the rig has run its seconds; say so when it fails."""
    watch = hub.watches["bearing"]
    deadline = time.monotonic() + seconds + 60
    while rig.poll() is None:
        tell(watch.seconds_seen, hub)
        if time.monotonic() > deadline:
            raise AfdsvcError("the rig agent did not finish in time")
        time.sleep(0.2)
    if rig.returncode != 0:
        raise AfdsvcError(f"the rig agent failed: {log.read_text(errors='replace')[-800:]}")
    hub.drain()
    tell(watch.seconds_seen, hub)


def _document(options: DemoOptions, site: Site, files: list[Path]) -> dict[str, Any]:
    recordings = [f for f in files if f.suffix == ".mcap"]
    document = diagnose_recordings(recordings)
    truth = [{"fault": n, "severity": s, "start_s": t} for n, s, t in options.faults]
    reviews = [str(f) for f in files if f.suffix == ".rrd"]
    return {
        **document,
        "truth": truth,
        "recording": str(recordings[0]) if recordings else None,
        "rerun": reviews[0] if reviews else None,
    }


def free_port() -> int:
    """Return a free loopback port."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])
