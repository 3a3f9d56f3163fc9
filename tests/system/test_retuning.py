"""From a fault to a healed machine through the whole service: proposed, accepted by a person, proved, recorded, taken back."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from afdsvc.app import ask, diagnose, serve
from afdsvc.app.ask import ask_service
from afdsvc.app.demo import measured_deviations
from afdsvc.app.rig import run_rig
from afdsvc.app.serve import audit_file
from afdsvc.errors import AfdsvcError
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import Site, parse_site
from afdsvc.plugins.manager import load
from afdsvc.service.audit_log import verify_chain
from afdsvc.wire.messages import EventKind

MACHINE = """plant = "gas_bearing"
input_sd = [0.1, 0.1]
driver = {seed = 4, faults = [{name = "horizontal_sensor", severity = -0.5, at_seconds = 0.0}]}
detectors = [{kind = "matched_filter"}]
bursts = {every_seconds = 3.5, first_after_seconds = 0.5, seconds = 2.0}"""


def site_of(port: int, folder: Path, machine: str = MACHINE) -> Site:
    text = f"""
site = "t"
[transport]
listen = ["tcp/127.0.0.1:{port}"]
[recording]
folder = "{folder}"
[[machines]]
id = "bearing"
{machine}
"""
    return parse_site(text, "site.toml")


@contextmanager
def rig(site: Site) -> Iterator[threading.Event]:
    stop = threading.Event()
    thread = threading.Thread(target=run_rig, args=(site, "bearing", None, stop), daemon=True)
    thread.start()
    try:
        yield stop
    finally:
        stop.set()
        thread.join(15)
        assert not thread.is_alive()


def eventually(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.02)


@pytest.mark.long
def test_what_an_alarm_proposes_a_person_accepts_and_takes_back(free_port, tmp_path):
    site = site_of(free_port, tmp_path)
    with serve.serving(site) as hub, rig(site):
        watch, retuning = hub.watches["bearing"], hub.retunings["bearing"]
        eventually(lambda: retuning.sentence.startswith("proposed: 'afdsvc retune bearing' designs Q for horizontal_sensor"))
        assert ask_service(site, "status", "Ada")["machines"][0]["tuning"] == retuning.sentence
        sheet = ask_service(site, "retune", "Ada", machine="bearing")
        name = sheet["tuning"]
        assert sheet["cost_after"] < 0.9 * sheet["cost_before"]
        assert sheet["severity"][0] < -0.5 < sheet["severity"][1]
        with pytest.raises(AfdsvcError, match="acts, accepted by Ada; restore the machine first"):
            ask_service(site, "retune", "Ada", machine="bearing")
        eventually(lambda: watch.pipeline._tuning == name)
        healed = watch.seconds_seen
        eventually(lambda: sum(e.seconds > healed and e.trustworthy for e in list(watch.evidence)) >= 2)
        assert ask_service(site, "restore", "Ada", machine="bearing", reason="enough") == {"machine": "bearing"}
        eventually(lambda: retuning.acting == "" and watch.pipeline._tuning == "")
        with pytest.raises(AfdsvcError, match="nothing is restored: no Q acts on machine"):
            ask_service(site, "restore", "Ada", machine="bearing")
        restored = watch.seconds_seen
        eventually(lambda: watch.evidence[-1].seconds > restored)
        hub.drain()
        live = list(watch.evidence)
    (path,) = tmp_path.glob("*.mcap")
    recording = Recording(path)
    events = [(e.kind, e.burst, e.cause) for e in recording.events("bearing") if e.kind in (EventKind.RETUNED, EventKind.RESTORED)]
    (asked,) = recording.retunings("bearing")
    assert events == [(EventKind.RETUNED, name, f"accepted by Ada: {asked.proof}"), (EventKind.RESTORED, name, "restored by Ada: enough")]
    said = [(e["who"], e["what"], e["outcome"]) for e in verify_chain(audit_file(site)).entries]
    assert ("Ada", "retune", f"Q {name} accepted") in said
    assert ("Ada", "restore", "done") in said
    within = [e for e in live if healed < e.seconds < restored]
    assert [e.reason for e in within if not e.trustworthy][1:] == []  # one burst at most played while Q came
    with_q = [e for e in within if e.trustworthy]
    assert {e.fault for e in with_q} == {"horizontal_sensor"}
    assert all(abs(e.severity.value + 0.5) < 4 * e.severity.sd for e in with_q)
    measured = measured_deviations(path)
    predicted = {row["signal"]: row["after"] / row["before"] for row in sheet["signals"]}
    assert max(predicted["u_horizontal"], predicted["u_vertical"]) < 0.6
    for signal, ratio in predicted.items():
        assert measured["healed"][signal] / measured["damaged"][signal] == pytest.approx(ratio, rel=0.35)  # seconds of a slowly decaying motion
    plugins = load()
    machine = diagnose._machine_of(recording, "bearing", list(recording.blocks("bearing")), None, None, plugins)
    again = diagnose.OfflineDiagnosis(machine, plugins)
    for request in recording.requests("bearing"):
        again.stream.announce(request.burst)
    again.stream.announce_tuning(name, asked.tuning.Q)
    for block in recording.blocks("bearing"):
        again.take(block)
    assert [repr(e) for e in again.evidence] == [repr(e) for e in live]  # to the last bit; nan, where samples are missing, is nan
    document = diagnose.diagnose_recordings([path])["recordings"][0]
    offline = [d["statistic"] for b in document["bursts"] for d in b["decisions"] if d["trustworthy"]]
    assert offline == [e.statistic for e in live if e.burst and e.trustworthy]


def test_nothing_is_retuned_before_a_fault_is_named(free_port, tmp_path):
    healthy = MACHINE.replace("severity = -0.5", "severity = 0.0")
    site = site_of(free_port, tmp_path, healthy)
    with serve.serving(site) as hub:
        with pytest.raises(AfdsvcError, match="machine 'bearing' is not connected"):
            ask_service(site, "retune", "Ada", machine="bearing")
        with rig(site):
            eventually(lambda: hub.watches["bearing"].blocks > 3)
            with pytest.raises(AfdsvcError, match="no fault has been named with its severity"):
                ask_service(site, "retune", "Ada", machine="bearing")
            for stated, why in (("horizontal_sensor", "expected NAME=LOW..HIGH"), ("horizontal_sensor=-0.4..-0.5", "expected the larger loss first"), ("pump=-0.5", "fault 'pump' is unknown")):
                with pytest.raises(AfdsvcError, match=why):
                    ask_service(site, "retune", "Ada", machine="bearing", fault=stated)
            with pytest.raises(AfdsvcError, match="nothing is restored: no Q acts on machine"):
                ask_service(site, "restore", "Ada", machine="bearing")
            with pytest.raises(AfdsvcError, match="machine 'x' is unknown"):
                ask_service(site, "retune", "Ada", machine="x")
        assert hub.retunings["bearing"].sentence == ""
    outcomes = [e["outcome"] for e in verify_chain(audit_file(site)).entries if e["what"] == "retune"]
    assert "no fault has been named with its severity, so there is nothing to design Q for; '--fault' states one" in outcomes
    assert not any("accepted" in outcome for outcome in outcomes)


@pytest.mark.long
def test_a_person_states_the_fault_before_a_burst_has_named_it(free_port, tmp_path):
    site = site_of(free_port, tmp_path, MACHINE.replace("every_seconds = 3.5, ", ""))
    with serve.serving(site) as hub, rig(site):
        eventually(lambda: hub.watches["bearing"].blocks > 3)
        sheet = ask_service(site, "retune", "Ada", machine="bearing", fault="horizontal_sensor=-0.52..-0.48")
        assert (sheet["fault"], sheet["severity"]) == ("horizontal_sensor", [-0.52, -0.48])
        eventually(lambda: hub.watches["bearing"].pipeline._tuning == sheet["tuning"])
        ask_service(site, "restore", "Ada", machine="bearing")
        hub.drain()
    (path,) = tmp_path.glob("*.mcap")
    (asked,) = Recording(path).retunings("bearing")
    assert (asked.found.fault, asked.found.low, asked.found.high) == ("horizontal_sensor", -0.52, -0.48)
    (done,) = [e for e in verify_chain(audit_file(site)).entries if e["what"] == "retune" and e["outcome"].endswith("accepted")]
    assert done["arguments"] == {"machine": "bearing", "fault": "horizontal_sensor", "low": -0.52, "high": -0.48}


@pytest.mark.parametrize("stage", ["designed", "designed and the rig not asked yet"])
def test_who_restores_before_q_acts_withdraws_it(free_port, tmp_path, monkeypatch, stage):
    monkeypatch.setattr(ask, "SILENT_SECONDS", 0.0)
    site, heard = site_of(free_port, tmp_path, MACHINE.replace("every_seconds = 3.5, ", "")), []
    withdrawn = "withdrawn by Eve while Q was designed: not now"
    with serve.serving(site) as hub, rig(site), ThreadPoolExecutor(1) as person:
        retuning = hub.retunings["bearing"]
        eventually(lambda: hub.watches["bearing"].blocks > 3)
        if stage != "designed":
            retuning.ready = lambda problem: retuning.restore("not now", "Eve")
        asked = person.submit(ask_service, site, "retune", "Ada", lambda: heard.append("waits"), machine="bearing", fault="horizontal_sensor=-0.52..-0.48")
        if stage == "designed":
            eventually(retuning._designing.locked)
            assert ask_service(site, "restore", "Eve", machine="bearing", reason="not now") == {"machine": "bearing"}
        with pytest.raises(AfdsvcError, match=withdrawn):
            asked.result(60)
        assert heard == ["waits"]
        eventually(lambda: retuning.acting == "" and hub.watches["bearing"].pipeline._tuning == "")
        hub.drain()
    (path,) = tmp_path.glob("*.mcap")
    events = [(e.kind, e.cause) for e in Recording(path).events("bearing") if e.kind in (EventKind.RETUNED, EventKind.RESTORED)]
    assert len(list(Recording(path).retunings("bearing"))) == (stage != "designed")
    assert events[1:] == [(EventKind.RESTORED, "restored by Eve: not now")] * len(events[1:])
    assert len(events) % 2 == 0  # what began has ended
    outcomes = [e["outcome"] for e in verify_chain(audit_file(site)).entries if e["what"] == "retune"]
    assert outcomes == ["being designed", withdrawn]


@pytest.mark.long
def test_what_was_proposed_for_a_fault_that_is_repaired_is_proposed_no_more(free_port, tmp_path):
    site = site_of(free_port, tmp_path)
    with serve.serving(site) as hub, rig(site):
        retuning = hub.retunings["bearing"]
        eventually(lambda: retuning.sentence.startswith("proposed"))
        ask_service(site, "inject", "Ada", machine="bearing", fault="horizontal_sensor", severity=0.0)
        eventually(lambda: not any(a.active for a in hub.alarms.of("bearing")))
        eventually(lambda: retuning.sentence == "", 5.0)
        with pytest.raises(AfdsvcError, match="no fault has been named with its severity"):
            ask_service(site, "retune", "Ada", machine="bearing")
