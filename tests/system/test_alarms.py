"""Alarms of a running service: over a restart, on the wire, as figures, with the minute before them in a file."""

from __future__ import annotations

import threading
import urllib.request
from pathlib import Path

import pytest

from afdsvc.app import rig, serve
from afdsvc.app.ask import ask_service
from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import Site, parse_site
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire import codec
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import AlarmChange


def site_of(port: int, folder: Path, metrics: int, machine: str) -> Site:
    text = f"""
site = "t"
[transport]
listen = ["tcp/127.0.0.1:{port}"]
[recording]
folder = "{folder}"
[metrics]
listen = "127.0.0.1:{metrics}"
[[machines]]
id = "bearing"
plant = "gas_bearing"
detectors = [{{kind = "regression"}}]
{machine}
"""
    return parse_site(text, "site.toml")


FAULTY = """driver = {real_time = false, seed = 4, faults = [{name = "vertical_actuator", severity = -0.5, at_seconds = 0.0}]}
bursts = {every_seconds = 30.0, first_after_seconds = 0.5, seconds = 2.0}"""


def scrape(port: int) -> dict[str, float]:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=5) as answer:
        lines = answer.read().decode().splitlines()
    return {line.rsplit(" ", 1)[0]: float(line.rsplit(" ", 1)[1]) for line in lines if not line.startswith("#")}


def run_rig(site: Site, seconds: float) -> None:
    thread = threading.Thread(target=rig.run_rig, args=(site, "bearing", seconds, threading.Event()), daemon=True)
    thread.start()
    thread.join(60)
    assert not thread.is_alive()


def test_an_alarm_is_reported_counted_kept_and_remembered(free_port, tmp_path):
    site = site_of(free_port, tmp_path, free_port + 1, FAULTY.replace("real_time = false, ", ""))
    heard: list[AlarmChange] = []
    with serve.serving(site) as hub:
        with Transport(site.transport, hub=False) as viewer:
            viewer.subscribe(Keys("t").alarms(), lambda key, payload: heard.append(codec.decode(AlarmChange, payload)))
            run_rig(site, 5.0)
            hub.drain()
            alarm = ask_service(site, "alarms", "kim")[0]
            with pytest.raises(AfdsvcError, match="not acknowledged"):
                ask_service(site, "confirm", "kim", alarm=alarm["id"])
            ask_service(site, "ack", "kim", alarm=alarm["id"], comment="on my way", seen_ns=alarm["since_ns"])
        figures = scrape(free_port + 1)
    assert alarm["id"] == "bearing/vertical_actuator"
    assert [c.event for c in heard] == ["raised", "acknowledged"]
    assert figures['afdsvc_alarms{acknowledged="true",kind="fault",machine="bearing"}'] == 1.0
    assert figures['afdsvc_blocks_total{machine="bearing"}'] > 50
    (before,) = (tmp_path / "alarms").glob("*.mcap")
    assert len(list(Recording(before).findings("bearing"))) == 1

    with serve.serving(site) as hub:
        (again,) = ask_service(site, "alarms", "lee")
        reported = ask_service(site, "history", "lee", alarm=again["id"])
    assert again["active"]
    assert (again["acknowledged_by"], again["comment"]) == ("kim", "on my way")
    assert [(c["event"], c["who"]) for c in reported] == [("raised", ""), ("acknowledged", "kim")]


def test_an_address_for_metrics_that_is_taken_stops_the_start_with_one_sentence(free_port, tmp_path):
    site = site_of(free_port, tmp_path, free_port, FAULTY)
    with pytest.raises(BadInput, match=f"metrics.listen = '127.0.0.1:{free_port}'"), serve.serving(site):
        pass
