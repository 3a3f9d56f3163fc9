"""The service over real zenoh with everything that can be wrong around it: each fault is named, none takes it down."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from afdsvc.api.signals import Block
from afdsvc.app import diagnose, serve
from afdsvc.app.ask import ask_service
from afdsvc.app.rig import run_rig
from afdsvc.errors import AfdsvcError
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import Site, parse_site
from afdsvc.plugins.manager import load
from afdsvc.service.hub import Hub
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire import codec
from afdsvc.wire.keys import Keys

KEYS = Keys("t")


def site_of(port: int, folder: Path, more: str = "", machine: str = "") -> Site:
    text = f"""
site = "t"
[transport]
listen = ["tcp/127.0.0.1:{port}"]
[recording]
folder = "{folder}"
{more}
[[machines]]
id = "bearing"
{machine or 'plant = "gas_bearing"'}
"""
    return parse_site(text, "site.toml")


@contextmanager
def rig(site: Site, seconds: float | None = None) -> Iterator[threading.Thread]:
    stop = threading.Event()
    thread = threading.Thread(target=run_rig, args=(site, "bearing", seconds, stop), daemon=True)
    thread.start()
    try:
        yield thread
    finally:
        stop.set()
        thread.join(15)
        assert not thread.is_alive()


def eventually(condition: Callable[[], bool], seconds: float = 15.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.02)


def notices(hub: Hub, path: Path) -> str:
    """Return every sentence in the recording's log so far."""
    hub.drain()
    time.sleep(0.8)
    recording = Recording(path)
    return "\n".join(e.data.decode(errors="replace") for e in recording.messages(what="log"))


def test_live_and_offline_agree_to_the_last_bit(free_port, tmp_path):
    """A fault, bursts, both kinds of decision; the recording gives the same evidence again."""
    machine = """plant = "gas_bearing"
driver = {seed = 4, faults = [{name = "vertical_actuator", severity = -0.5, at_seconds = 2.5}]}
bursts = {every_seconds = 3.5, first_after_seconds = 0.5, seconds = 2.0}"""
    site = site_of(free_port, tmp_path, machine=machine)
    with serve.serving(site) as hub, rig(site, 10.0) as thread:
        thread.join(40)
        hub.drain()
        live = list(hub.watches["bearing"].evidence)
        assert hub.alarms.alarms["bearing/vertical_actuator"].active
        assert hub.watches["bearing"].lost_samples == 0
    (path,) = tmp_path.glob("*.mcap")
    recording = Recording(path)
    assert recording.loss == ""
    bursts = [r.burst for r in recording.requests("bearing")]
    plugins = load()
    machine_ = diagnose._machine_of(recording, "bearing", list(recording.blocks("bearing")), None, None, plugins)
    again = diagnose.evidence_of(machine_, recording.blocks("bearing"), bursts, plugins)
    assert [f.evidence for f in recording.findings("bearing")] == live
    assert again.evidence == live
    document = diagnose.diagnose_recordings([path])
    verdict = document["recordings"][0]["verdict"]
    assert verdict["fault"] == "vertical_actuator"
    assert abs(verdict["severity"]["value"] + 0.5) < 4 * verdict["severity"]["sd"]
    assert verdict["first_detected_s"] > 2.5


def test_a_burst_that_tells_a_fault_but_not_which_is_followed_by_one_that_tells(free_port, tmp_path):
    """Two-step isolation (thesis 5.5): a faint burst first, then one made for the two likeliest faults."""
    machine = """plant = "gas_bearing"
driver = {seed = 4, faults = [{name = "vertical_actuator", severity = -0.5, at_seconds = 0.0}]}
detectors = [{kind = "fault_curves"}]
bursts = {every_seconds = 30.0, first_after_seconds = 0.5, seconds = 1.0, output_amplitude = 0.3}"""
    site = site_of(free_port, tmp_path, machine=machine)
    with serve.serving(site) as hub, rig(site, 6.0) as thread:
        thread.join(40)
        hub.drain()
        first, second = hub.watches["bearing"].evidence
    assert first.detected
    assert first.fault is None
    assert second.fault == "vertical_actuator"
    assert second.severity is not None
    assert abs(second.severity.value + 0.5) < 4 * second.severity.sd
    (path,) = tmp_path.glob("*.mcap")
    requests = list(Recording(path).requests("bearing"))
    assert [r.burst.purpose for r in requests] == ["diagnose", "isolate"]
    assert "does not decide whether it is" in requests[1].asked_by


def test_a_burst_asked_for_in_the_first_moment_can_be_judged(free_port, tmp_path):
    machine = 'plant = "gas_bearing"\nbursts = {seconds = 1.0}'
    site = site_of(free_port, tmp_path, machine=machine)
    with serve.serving(site) as hub, rig(site):
        requests = hub.burst_requests["bearing"]
        eventually(lambda: requests.pipeline.ready_at is not None and bool(requests.session))
        ask_service(site, "burst", "Ada")
        eventually(lambda: len(hub.watches["bearing"].evidence) > 0)
        assert [e.reason for e in hub.watches["bearing"].evidence if not e.trustworthy] == []


def test_a_machine_whose_noise_is_learnt_is_excited_afterwards(free_port, tmp_path):
    machine = """plant = "gas_bearing"
calibrate_seconds = 2.0
driver = {seed = 4, faults = [{name = "vertical_actuator", severity = -0.5, at_seconds = 0.0}]}
bursts = {every_seconds = 30.0, first_after_seconds = 0.5, seconds = 2.0}"""
    site = site_of(free_port, tmp_path, machine=machine)
    with serve.serving(site) as hub, rig(site, 8.0) as thread:
        with pytest.raises(AfdsvcError, match=r"no usable samples yet|not connected"):
            ask_service(site, "burst", "Ada")
        thread.join(40)
        hub.drain(60.0)
        found = list(hub.watches["bearing"].evidence)
    assert any(e.fault == "vertical_actuator" and e.trustworthy for e in found)


def test_people_can_ask_and_hear_why_not(free_port, tmp_path):
    site = site_of(free_port, tmp_path)
    with serve.serving(site) as hub:
        with pytest.raises(AfdsvcError, match="machine 'bearing' is not connected"):
            ask_service(site, "burst", "Ada")
        assert ask_service(site, "status", "Ada")["machines"][0]["state"] == "absent"
        with rig(site):
            eventually(lambda: ask_service(site, "status", "Ada")["machines"][0]["state"] == "running")
            name = ask_service(site, "burst", "Ada")["burst"]
            with pytest.raises(AfdsvcError, match="only one burst"):
                ask_service(site, "burst", "Ada")
            eventually(lambda: hub.watches["bearing"].pipeline._burst[0] == name)  # stopped before its first sample it leaves none
            ask_service(site, "stop", "Ada", reason="enough")
            eventually(lambda: any("stopped by Ada: enough" in cause for cause in hub.refusals))
            with pytest.raises(AfdsvcError, match="nothing is stopped"):
                ask_service(site, "stop", "Ada")
            eventually(lambda: any(e.burst == name for e in list(hub.watches["bearing"].evidence)))
            ask_service(site, "pause", "Ada", reason="cleaning")
            with pytest.raises(AfdsvcError, match="paused: by Ada: cleaning"):
                ask_service(site, "burst", "Ada")
            with pytest.raises(AfdsvcError, match="machine 'x' is unknown; this site has bearing"):
                ask_service(site, "burst", "Ada", machine="x")
            with pytest.raises(AfdsvcError, match="unknown command 'explode'; known are ack, alarms, burst"):
                ask_service(site, "explode", "Ada")
            with pytest.raises(AfdsvcError, match="no alarm 'a'"):
                ask_service(site, "ack", "Ada", alarm="a")


def listening() -> list[str]:
    """Return the addresses this process listens at, as the kernel writes them."""
    mine = {os.readlink(f) for f in Path("/proc/self/fd").iterdir() if f.is_symlink() and f.exists()}
    rows = [
        row.split() for kind in ("tcp", "tcp6", "udp", "udp6") for row in Path(f"/proc/net/{kind}").read_text().splitlines()[1:]
    ]
    return [r[1].split(":")[0] for r in rows if r[3] in ("0A", "07") and f"socket:[{r[9]}]" in mine]


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="needs Linux's /proc")
def test_the_service_listens_on_loopback_only(free_port, tmp_path):
    site = site_of(free_port, tmp_path, more='[review]\nrerun = "file"')
    with serve.serving(site) as hub, rig(site):
        eventually(lambda: hub.watches["bearing"].blocks > 5)
        assert listening() == ["0100007F"]


class Stranger:
    """A peer that speaks the protocol and says wrong things."""

    def __init__(self, transport: Transport, site: Site) -> None:
        machine = site.machines[0]
        from afdsvc.app import commissioning

        self.parts = commissioning.commission(machine, load())
        self.transport, self.k, self.seq = transport, 0, 0
        self.rng = np.random.default_rng(0)
        transport.announce(KEYS.alive("bearing", "s1"))

    def block(self, n: int = 250, **changes) -> Block:
        values = 0.4 * self.rng.standard_normal((n, len(self.parts.channels)))
        block = Block("bearing", "s1", self.seq, self.k, 2e-4, 1, self.parts.channels, values)
        self.k, self.seq = self.k + n, self.seq + 1
        return replace(block, **changes)

    def say(self, payload: Block | bytes) -> None:
        data = payload if isinstance(payload, bytes) else codec.encode_block(payload)
        self.transport.publish(KEYS.block("bearing"), data)


def test_wrong_blocks_are_named_and_survived(free_port, tmp_path):
    site = site_of(free_port, tmp_path)
    with serve.serving(site) as hub, Transport(site.transport, hub=False) as peer:
        stranger = Stranger(peer, site)
        good = stranger.block()
        stranger.say(good)
        stranger.say(b"\xff\x00 not protobuf")
        stranger.say(good)
        late = stranger.block()
        missing = stranger.block()
        stranger.say(stranger.block())
        stranger.say(late)
        nan = stranger.block()
        nan.values[17, 2] = np.nan
        stranger.say(nan)
        frozen = stranger.block()
        frozen.values[:, 3] = 0.25
        stranger.say(frozen)
        stranger.say(stranger.block(dt=1e-3))
        channels = stranger.parts.channels[:-1]
        stranger.say(stranger.block(channels=channels, values=np.zeros((250, len(channels)))))
        stranger.say(stranger.block())
        watch = hub.watches["bearing"]
        eventually(lambda: watch.seconds_seen >= stranger.k * 2e-4 - 1e-9)
        said = notices(hub, next(tmp_path.glob("*.mcap")))
        status = ask_service(site, "status", "Ada")["machines"][0]
    assert missing.k0 == 500
    for words in (
        "could not be read",
        "out of order",
        "500 samples (2 blocks)",
        "'y_horizontal' is NaN at sample",
        "'y_vertical' has not changed for",
        "sampled at 0.001 s",
        "channels u_horizontal",
    ):
        assert words in said
    assert status["lost_blocks"] >= 500


def test_a_second_rig_is_named_and_not_listened_to(free_port, tmp_path):
    site = site_of(free_port, tmp_path)
    with (
        serve.serving(site) as hub,
        Transport(site.transport, hub=False) as a,
        Transport(site.transport, hub=False) as b,
    ):
        one = Stranger(a, site)
        one.say(one.block())
        watch = hub.watches["bearing"]
        eventually(lambda: watch.blocks == 1)
        b.announce(KEYS.alive("bearing", "s2"))
        time.sleep(0.3)
        b.publish(KEYS.block("bearing"), codec.encode_block(replace(one.block(), session="s2", k0=0)))
        time.sleep(0.3)
        one.say(replace(one.block(), k0=250, seq=1))
        eventually(lambda: watch.blocks == 2)
        assert watch.session == "s1"
        said = notices(hub, next(tmp_path.glob("*.mcap")))
    assert "a second rig agent (session s2) claims to be 'bearing'" in said


def test_a_recording_that_cannot_be_written_stops_nothing(free_port, tmp_path):
    """The folder is gone after the start, and a file stands in its place."""
    site = site_of(free_port, tmp_path / "file" / "recordings")
    with serve.serving(site) as hub:
        (tmp_path / "file").rename(tmp_path / "gone")  # at once, while the service writes there
        (tmp_path / "file").write_text("in the way")
        with rig(site):
            eventually(lambda: hub.watches["bearing"].blocks > 20)
            status = ask_service(site, "status", "Ada")
    assert "file" in status["recording_failure"]
    assert status["recording_dropped"] > 0
    assert status["machines"][0]["state"] == "running"


def test_a_rig_that_goes_and_comes_back_raises_no_alarm(free_port, tmp_path):
    site = site_of(free_port, tmp_path)
    with serve.serving(site) as hub:
        watch = hub.watches["bearing"]
        with rig(site):
            eventually(lambda: watch.blocks > 20)
        eventually(lambda: not watch.present)
        before = watch.blocks
        with rig(site):
            eventually(lambda: watch.blocks > before + 40)
            assert ask_service(site, "burst", "Ada")["burst"]
            eventually(lambda: any(e.burst for e in list(watch.evidence)))
        assert hub.alarms.alarms == {}
        said = notices(hub, next(tmp_path.glob("*.mcap")))
    assert "is disconnected" in said


def test_the_service_restarts_while_the_rig_runs(free_port, tmp_path):
    sure = [f'{{kind = "{name}", false_alarms_per_1000_bursts = 1e-4}}' for name in ("matched_filter", "regression", "cusum")]
    machine = f'plant = "gas_bearing"\ndetectors = [{", ".join(sure)}]'  # no alarm by chance, but one for what the restart does
    site = site_of(free_port, tmp_path / "a", machine=machine)
    again = site_of(free_port, tmp_path / "b", machine=machine)
    with rig(site):
        with serve.serving(site) as hub:
            eventually(lambda: hub.watches["bearing"].blocks > 20)
        time.sleep(1.0)
        with serve.serving(again) as hub:
            eventually(lambda: hub.watches["bearing"].blocks > 20, 30)
            eventually(lambda: hub.watches["bearing"].present)
            time.sleep(0.2)
            assert ask_service(again, "burst", "Ada")["burst"]
            eventually(lambda: any(e.burst for e in list(hub.watches["bearing"].evidence)))
            assert hub.alarms.alarms == {}


def test_the_measured_axis_goes_through_bit_for_bit(free_port, tmp_path, measured):
    """Rig in replay mode, zenoh, service, observer on the naive model, passive CUSUM, whiteness gate, MCAP."""
    emps = measured / "emps"
    machine = f"""model = "{emps / "model.toml"}"
driver = {{kind = "replay", recording = "{emps / "estimation.csv"}", real_time = false}}
calibrate_seconds = 12.4
detectors = [{{kind = "passive_cusum"}}]"""
    site = site_of(free_port, tmp_path, machine=machine)
    table = np.loadtxt(emps / "estimation.csv", delimiter=",", skiprows=1)
    with serve.serving(site) as hub, rig(site) as thread:
        thread.join(60)
        eventually(lambda: hub.watches["bearing"].seconds_seen > (len(table) - 0.5) * 1e-3, 60)
        hub.drain(60)
        evidence = list(hub.watches["bearing"].evidence)
        assert hub.watches["bearing"].lost_samples == 0
        assert hub.alarms.alarms == {}
    assert evidence
    assert all(not e.trustworthy for e in evidence)
    assert any("the model is incomplete" in e.reason for e in evidence)
    recording = Recording(next(tmp_path.glob("*.mcap")))
    (trace,) = recording.traces("bearing")
    assert [c.name for c in trace.channels] == ["u_force", "y_position", "ref_position"]
    assert np.array_equal(trace.values, table[:, 1:])
    assert "rate_of" in recording.attachments["bearing/model.toml"].decode()
