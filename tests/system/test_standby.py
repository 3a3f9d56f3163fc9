"""Two services for one site, as processes: the second keeps the alarms of the first and takes over when that is killed."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path

import pytest

from afdsvc.app.ask import ask_service
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import read_site
from afdsvc.service.notifications import History
from afdsvc.wire.messages import EventKind
from tests.system.test_reliability_processes import eventually

TAKEN_OVER_SECONDS = 5.0
SITE = """site = "t"
[transport]
listen = ["tcp/127.0.0.1:{port}"]
standby = ["tcp/127.0.0.1:{second}"]
patience_seconds = 1
[recording]
folder = "{folder}"
[[machines]]
id = "bearing"
plant = "gas_bearing"
detectors = [{{kind = "regression"}}]
driver = {{seed = 4, faults = [{{name = "vertical_actuator", severity = -0.5, at_seconds = 0.0}}]}}
bursts = {{every_seconds = 4.0, first_after_seconds = 0.5, seconds = 2.0, rest_seconds = 0.5}}
"""


@contextmanager
def process(log: Path, *arguments: str) -> Iterator[subprocess.Popen]:
    with log.open("ab") as file, subprocess.Popen([sys.executable, "-m", "afdsvc", *arguments], stderr=file) as started:
        try:
            yield started
        finally:
            started.kill()


def played(*folders: Path) -> list[tuple[str, int, int]]:
    """Return name, first sample and the sample after the last of every burst in the recordings; both services hear what a rig said last."""
    events = {e for folder in folders for path in sorted(folder.glob("*.mcap")) for e in Recording(path).events("bearing")}
    over = {e.burst: e.k for e in events if e.kind in (EventKind.BURST_ENDED, EventKind.BURST_ABORTED)}
    return sorted(((e.burst, e.k, over.get(e.burst, e.k)) for e in events if e.kind is EventKind.BURST_STARTED), key=lambda burst: burst[1])


@pytest.mark.long
@pytest.mark.timeout(300)
def test_the_second_service_takes_over_within_five_seconds_and_keeps_alarms_and_acknowledgements(tmp_path, free_port, capsys):
    sites = [tmp_path / "first.toml", tmp_path / "second.toml"]
    for path in sites:
        path.write_text(SITE.format(port=free_port, second=free_port + 1, folder=path.stem))
    site, kept = read_site(sites[0]), History(tmp_path / "second" / "t-alarms.sqlite")

    def machine() -> dict:
        return ask_service(site, "status", "kim")["machines"][0]

    with ExitStack() as stack:
        first = stack.enter_context(process(tmp_path / "first.log", "serve", str(sites[0])))
        stack.enter_context(process(tmp_path / "rig.log", "rig", str(sites[0]), "--machine", "bearing"))
        eventually(lambda: ask_service(site, "alarms", "kim"))
        stack.enter_context(process(tmp_path / "second.log", "serve", str(sites[1]), "--standby", "--log", "json"))
        alarm = ask_service(site, "alarms", "kim")[0]
        ask_service(site, "ack", "kim", alarm=alarm["id"], comment="on my way")
        eventually(lambda: any(a.acknowledged_by == "kim" for a in kept.last()))
        eventually(lambda: machine()["burst"])
        first.kill()
        died = time.monotonic()
        eventually(lambda: "is connected" in (tmp_path / "second.log").read_text(), TAKEN_OVER_SECONDS)
        with capsys.disabled():
            print(f"\ntaken over {time.monotonic() - died:.1f} s after the first service was killed")
        eventually(lambda: machine()["blocks"])
        (again,) = ask_service(site, "alarms", "lee")
        assert (again["id"], again["acknowledged_by"], again["comment"]) == (alarm["id"], "kim", "on my way")
        eventually(lambda: "regression: " in (tmp_path / "second.log").read_text())  # a burst of its own has been judged
        stack.enter_context(process(tmp_path / "first.log", "serve", str(sites[0])))
        eventually(lambda: "this one stands by" in (tmp_path / "first.log").read_text())
        assert machine()["blocks"] > 0

    bursts = played(tmp_path / "first", tmp_path / "second")
    assert len({name for name, _, _ in bursts}) == len(bursts) > 1
    assert all(end <= begin for (_, _, end), (_, begin, _) in pairwise(bursts))
