"""`afdsvc demo`: a simulated machine in a second process, bursts, a fault, a comparison of truth and result, and a Q that heals."""

from __future__ import annotations

import contextlib
import getpass
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from afdsvc.api.signals import of_role
from afdsvc.app.ask import ask_service
from afdsvc.app.demo_site import DemoOptions, free_port, site_text
from afdsvc.app.diagnose import diagnose_recordings
from afdsvc.app.review import fault_planes
from afdsvc.app.serve import serving
from afdsvc.errors import AfdsvcError
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import Site, read_site
from afdsvc.present.rerun import review_recordings
from afdsvc.service.hub import Hub
from afdsvc.wire.messages import EventKind


def happening(hub: Hub) -> str:
    """Return what happens to the machine now, in a few words."""
    watch, requests = hub.watches["bearing"], hub.burst_requests["bearing"]
    found = watch.verdict()
    named = f", found {found.fault} {100 * found.severity.value:.1f} %" if found.fault and found.severity else ", a fault is detected" if found.detected else ""
    return ("the machine starts" if not watch.blocks else "a burst plays" if requests.playing else "its own noise is watched") + named


def run_demo(options: DemoOptions, tell: Callable[[float, Hub], None]) -> dict[str, Any]:
    """Run the demonstration; ``tell(done seconds, hub)`` is called several times a second. Returns the JSON document."""
    with tempfile.TemporaryDirectory(prefix="afdsvc-demo-") as folder:
        path = Path(folder) / "site.toml"
        history = f'[alarms]\nhistory = "{(Path(folder) / "alarms.sqlite").as_posix()}"\n'  # alarms of earlier demonstrations are not part of this one
        console = f'[web]\nlisten = "{options.console}"\n' if options.console else ""
        path.write_text(site_text(options, free_port()) + history + console, encoding="utf-8")
        site = read_site(path)
        with serving(site) as hub, rig_process(path, "bearing", options.seconds) as rig, ThreadPoolExecutor(1) as person:
            healing = _Healing(site, person) if options.heal else None
            _wait(hub, rig, path.parent / "rig.log", options.seconds, tell, healing)
            files = hub.files()
    return {**_document(options, site, files), **({} if healing is None else healing.document(files))}


class _Healing:
    """The person who accepts the first Q that is proposed; what became of it."""

    def __init__(self, site: Site, person: ThreadPoolExecutor) -> None:
        self._site, self._person = site, person
        self._asked: Future[Any] | None = None

    def accept(self, hub: Hub) -> None:
        """Accept what is proposed, once."""
        if self._asked is None and hub.retunings["bearing"].sentence:
            self._asked = self._person.submit(ask_service, self._site, "retune", getpass.getuser(), machine="bearing")

    def document(self, files: list[Path]) -> dict[str, Any]:
        """Return the design sheet, or why there is none, and what was measured without bursts: healthy, damaged, healed."""
        sheet: Any = {"refused": "no fault was named with its severity while the machine ran"}
        if self._asked is not None:
            refusal = self._asked.exception()
            sheet = {"refused": str(refusal)} if refusal else self._asked.result()
        return {"retuning": sheet, "measured": measured_deviations(next(f for f in files if f.suffix == ".mcap"))}


def measured_deviations(path: Path) -> dict[str, dict[str, float]]:
    """Return the standard deviation of every input and output of a recording, by stretch: healthy, damaged and healed.

    A block in which a burst or the gain of a Q moves, or that follows on one, is left out.
    """
    recording = Recording(path)
    since = min((e.k for e in recording.events() if e.kind is EventKind.FAULT_INJECTED), default=2**63)
    stretches: dict[str, list[Any]] = {"healthy": [], "damaged": [], "healed": []}
    before = None
    for block in recording.blocks():
        quiet = before is not None and not (block.burst or before.burst) and block.tuning == before.tuning
        before = block
        if quiet and not block.tuning.endswith(" moves"):
            state = "healed" if block.tuning else "damaged" if block.k0 >= since else "healthy" if block.k0 + len(block) <= since else ""
            columns = [i for role in ("u", "y") for i in of_role(block.channels, role)]
            if state:
                stretches[state].append(block.values[:, columns])
    names = [] if before is None else [before.channels[i].name for role in ("u", "y") for i in of_role(before.channels, role)]
    return {state: dict(zip(names, np.vstack(rows).std(axis=0).tolist(), strict=True)) for state, rows in stretches.items() if rows}


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


def _wait(
    hub: Hub, rig: subprocess.Popen[bytes], log: Path, seconds: float, tell: Callable[[float, Hub], None], healing: _Healing | None
) -> None:  # fmt: skip
    """Wait until the rig has run its seconds; say so when it fails, or when nothing has come from it for a minute."""
    watch, seen = hub.watches["bearing"], 0.0
    deadline = time.monotonic() + seconds + 60
    while rig.poll() is None:
        tell(watch.seconds_seen, hub)
        if watch.seconds_seen != seen:
            seen, deadline = watch.seconds_seen, time.monotonic() + 60
        if healing:
            healing.accept(hub)
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
    late = next((b.k0 * b.dt for f in recordings for b in Recording(f).blocks()), 0.0)  # when the service heard the rig first
    truth = [{"fault": n, "severity": s, "start_s": round(t - late, 3)} for n, s, t in options.faults]
    review = next((f for f in files if f.suffix == ".rrd"), None)
    if review and recordings:
        review_recordings(recordings, review, planes=fault_planes)  # what the live one has not: fault curves with the measured points
    return {
        **document,
        "truth": truth,
        "recording": str(recordings[0]) if recordings else None,
        "rerun": str(review) if review else None,
    }
