"""Bugs that users of comparable software reported, one test each, named after the thread: none of them is ours.

Threads: selfpatch/ros2_medkit, ros/diagnostics, ros-controls/ros2_control, ControlSystemStudio/phoebus, tango-controls/cppTango,
bluesky/ophyd-async, DiamondLightSource/blueapi, dora-rs/dora, copper-project/copper-rs, ros2/rosbag2, cedbossneo/mowglinext,
zauberzeug/rosys.
"""

from __future__ import annotations

import logging
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from pydantic import ValidationError

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.evidence import Evidence
from afdsvc.api.signals import Block, Channel, residual_block
from afdsvc.app import commissioning, ports
from afdsvc.diagnosis.alarm_book import AlarmBook, Policy
from afdsvc.diagnosis.data_quality import StreamFinding
from afdsvc.diagnosis.pipeline import Outcome
from afdsvc.errors import BadInput, Refused
from afdsvc.files.recording.mcap_file import Header
from afdsvc.files.recording.mcap_records import is_finished
from afdsvc.files.recording.reader import Recording
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.files.recording.recover import recover_in_place
from afdsvc.files.site import Alarms, Bursts, DriverSection, MachineSection
from afdsvc.hal.control_loop import LoopSettings
from afdsvc.hal.hardware import DrivenRig
from afdsvc.service.burst_requests import BurstRequests
from afdsvc.service.clock import FastClock
from afdsvc.service.housekeeping import Keep, tidy
from afdsvc.service.hub import Hub
from afdsvc.service.machine import MachineMonitor
from afdsvc.service.notifications import History
from afdsvc.service.recorder_sink import PreAlarmBuffer
from afdsvc.service.scheduler import BurstOrder, Scheduler
from afdsvc.service.sinks import Publisher
from afdsvc.transport.zenoh_session import PeerSilent
from afdsvc.wire import codec
from afdsvc.wire.codec import Message
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import (
    AlarmChange,
    AlarmKind,
    BurstReply,
    EventKind,
    Finding,
    Notice,
    Residual,
    RigDescription,
    RigEvent,
)

CHANNELS = (Channel("u_x", "V"), Channel("y_x", "um"))
T = 1_763_000_000_000_000_000
SECOND = 10**9
SINE = Burst("b1", 2, 1000, 100, (Line(0, 390.0, 0.3),))


def decision(detected: bool, n: int = 0, fault: str = "pump", detector: str = "d") -> Finding:
    return Finding(Evidence(detector, "m1", n, 0.0, 9.0, 5.0, detected, "b", "y", fault if detected else None), "s1", T + n)


def block(seq: int = 0, session: str = "s1", machine: str = "m1") -> Block:
    return Block(machine, session, seq, 50 * seq, 1e-3, T + seq * 50_000_000, CHANNELS, np.ones((50, 2)) * seq)


class Everything:
    """A sink that remembers what it was given."""

    def __init__(self) -> None:
        self.got: list = []

    def take(self, message):
        self.got.append(message.value)

    def of(self, kind):
        return [value for value in self.got if isinstance(value, kind)]


class Says:
    """A stream that says of every block what it is given to say."""

    def __init__(self) -> None:
        self.outcome, self.dt, self.bursts, self.ready_at = Outcome((), (), np.zeros((50, 1))), 1e-3, {}, 0

    def announce(self, burst):
        pass

    def step(self, block):
        return self.outcome


def service(desk: BurstRequests | None = None) -> tuple[Hub, MachineMonitor, Says]:
    stream = Says()
    watch = MachineMonitor("m1", stream, Everything(), FastClock())
    hub = Hub(Keys("t"), "1", {"m1": watch}, {"m1": desk} if desk else {}, None, FastClock(), lambda: ("", 0, "", 0))
    return hub, watch, stream


def desk(ask=None) -> BurstRequests:
    transport = SimpleNamespace(ask=ask, publish=lambda *a, **k: None)
    scheduler = Scheduler(Bursts(), np.random.default_rng(0), 0.0)
    made = BurstRequests("m1", lambda wanted: SINE, scheduler, Says(), Everything(), Keys("t"), transport, FastClock())
    made.present("s1", 10.0)
    return made


# --------------------------------------------------------------------------------------------------------- ros2_medkit


def test_medkit_428_a_long_quiet_time_does_not_make_an_alarm_late():
    """Their debounce counter ran without bound: after a thousand good reports it took a thousand bad ones."""
    book = AlarmBook(Policy(raise_after=3, clear_after=2))
    for n in range(10_000):
        book.take(decision(False, n))
    assert [bool(book.take(decision(True, 10_000 + n))) for n in range(3)] == [False, False, True]
    for n in range(10_000):
        book.take(decision(True, 20_000 + n))
    for n in range(2):
        book.take(decision(False, 30_000 + n))
    assert not book.alarms["m1/pump"].active


def test_medkit_144_what_comes_again_after_it_was_cleared_is_raised_again():
    book = AlarmBook(Policy(clear_after=1))
    book.take(decision(True))
    book.acknowledge("m1/pump", "kim")
    book.take(decision(False, 1))
    assert not book.alarms["m1/pump"].active
    book.take(decision(True, 2))
    again = book.alarms["m1/pump"]
    assert again.active
    assert not again.acknowledged


def test_medkit_642_no_setting_silences_alarms_unseen():
    """A documented debounce value switched their faults off; ours are bounded, and the extremes still raise and end."""
    for bad in ({"raise_after": 0}, {"raise_after": -1}, {"raise_after": 21}, {"clear_after": 0}, {"clear_after": 101}):
        with pytest.raises(ValidationError):
            Alarms(**bad)
    for raise_after in (1, 20):
        book = AlarmBook(Policy(raise_after=raise_after))
        assert [bool(book.take(decision(True, n))) for n in range(raise_after)][-1]


def test_medkit_105_consequences_stand_under_their_cause():
    book = AlarmBook()
    for fault in ("pump", "valve", "sensor"):
        book.take(decision(True, fault=fault, detector=fault))
    book.group("m1", "pump", T)
    assert {a.fault: a.cause for a in book.alarms.values()} == {"pump": "", "valve": "m1/pump", "sensor": "m1/pump"}


@pytest.mark.parametrize("thread", ["medkit_120", "mowglinext_718", "rosbag2_1409", "rosbag2_837"])
def test_what_came_before_the_trigger_is_in_a_file_of_its_own(tmp_path, thread):
    """All four ask for the time before the event: a ring buffer in memory, written when something happens."""
    box, reported = PreAlarmBuffer(tmp_path / thread, Header(), seconds=2.0), []
    for seq in range(100):
        box.take(Message(block(seq)))
    book = AlarmBook(tell=reported.append)
    book.take(decision(True))
    box.take(Message(reported[0]))
    kept = [b.seq for b in Recording(box.paths[0]).blocks()]
    assert kept[-1] == 99
    assert 39 <= len(kept) <= 42


# --------------------------------------------------------------------------------------------------------- diagnostics


def test_diagnostics_506_593_stale_is_not_an_error_and_the_reason_is_named():
    hub, watch, _ = service()
    watch.appeared("s1")
    watch.take_block(codec.encode_block(block()))
    assert watch.status("", 0.0, ()).state == "running"
    hub.clock, watch.clock._seconds = FastClock(), 5.0
    status = watch.status("", 0.0, ())
    assert (status.state, status.reason) == ("stale", "no block for 5.0 s")
    assert hub.alarms.alarms == {}


def test_diagnostics_167_168_two_things_in_one_moment_are_both_reported():
    """A queue of one overlooked the error between two good reports."""
    hub, watch, stream = service()
    stream.outcome = Outcome((), (StreamFinding("bad_samples", "'y_x' is NaN"), StreamFinding("frozen_sensor", "'y_x' stands still")), None)
    hub._block(watch, codec.encode_block(block(0)))
    stream.outcome = Outcome((), (), np.zeros((50, 1)))
    hub._block(watch, codec.encode_block(block(1)))
    changes = [c.event for c in watch.sink.of(AlarmChange)]
    assert changes == ["raised", "raised", "ended", "ended"]


def test_diagnostics_143_a_machine_nobody_announced_is_named_once_and_does_not_disturb(caplog):
    hub, watch, _ = service()
    with caplog.at_level(logging.WARNING):
        for seq in range(5):
            hub._handle("block", Keys("t").block("unknown"), codec.encode_block(block(seq, machine="unknown")))
    assert [r.message for r in caplog.records] == ["machine 'unknown' is not in the site file; its messages are ignored"]
    assert watch.blocks == 0


# -------------------------------------------------------------------------------------------------------- ros2_control


def test_ros2_control_712_a_command_to_dead_hardware_fails_and_says_so():
    nobody = desk()
    nobody.present("", 0.0)
    with pytest.raises(Refused, match="machine 'm1' is not connected"):
        nobody.ask(BurstOrder("kim"))

    def silent(*_):
        raise PeerSilent("no answer")

    dead = desk(silent)
    with pytest.raises(PeerSilent):
        dead.ask(BurstOrder("kim"))
    assert dead.playing == ""
    with pytest.raises(PeerSilent):
        dead.stop("enough", "kim")
    nothing = desk(lambda *_: codec.encode(BurstReply(False, "", "no such burst is playing")))
    with pytest.raises(Refused, match="nothing is stopped: no such burst is playing"):
        nothing.stop("", "")


class Hardware:
    """A driver that counts its ticks and can break."""

    def __init__(self, breaks_at: int = 10**9) -> None:
        self.ticks = self.written = 0
        self.breaks_at, self.resting = breaks_at, False

    def open(self):
        pass

    def read(self):
        self.ticks += 1
        if self.ticks == self.breaks_at:
            raise OSError("bus error")
        return [0.0, 0.0]

    def write(self, u):
        self.written += 1

    def rest(self):
        self.resting = True

    def close(self):
        pass


def driven(bearing, hardware: Hardware) -> DrivenRig:
    m = bearing()
    return DrivenRig(hardware, m.controller.interconnection, m.channels, m.limits, LoopSettings("m1", "s1"), FastClock())


@pytest.mark.parametrize("thread", ["ros2_control_546", "ros2_control_742"])
def test_an_error_on_reading_stops_the_controller_and_rests_the_machine(bearing, thread):
    hardware = Hardware(breaks_at=321)
    port = driven(bearing, hardware)
    port.read()
    with pytest.raises(OSError, match="bus error"):
        port.read()
    assert hardware.resting
    assert hardware.written == 320


def test_ros2_control_2089_no_control_cycle_is_skipped(bearing):
    hardware = Hardware()
    port = driven(bearing, hardware)
    blocks = [port.read() for _ in range(8)]
    assert hardware.ticks == hardware.written == sum(map(len, blocks))
    assert all(b.k0 + len(b) == c.k0 for b, c in pairwise(blocks))


def test_ros2_control_2141_hardware_reports_its_own_health():
    _, watch, _ = service()
    described = RigDescription("m1", "s1", T, 1e-3, CHANNELS, samples=1000, late=7, head_room=0.31)
    watch.take_description(codec.encode(described))
    assert watch.status("", 0.0, ()).head_room == 0.31


# -------------------------------------------------------------------------------------------------------------- phoebus


def test_phoebus_3078_an_acknowledgement_survives_a_restart(tmp_path):
    history = History(tmp_path / "a.sqlite")
    book = AlarmBook(tell=history.add)
    book.take(decision(True))
    book.acknowledge("m1/pump", "kim", "on my way", T)
    again = AlarmBook()
    again.restore(History(tmp_path / "a.sqlite").last(), T + 1)
    assert again.alarms["m1/pump"].acknowledged_by == "kim"
    assert again.alarms["m1/pump"].comment == "on my way"


def test_phoebus_1928_acknowledging_what_was_seen_does_not_acknowledge_what_came_since():
    book = AlarmBook(Policy(clear_after=1))
    seen = book.take(decision(True))
    book.take(decision(False, 1))
    book.take(decision(True, 2))
    with pytest.raises(Refused, match="has occurred again since"):
        book.acknowledge("m1/pump", "kim", "", T, seen.since_ns)
    assert not book.alarms["m1/pump"].acknowledged


def test_phoebus_1966_what_is_put_aside_during_its_delay_is_not_raised_by_the_delay():
    book = AlarmBook(Policy(raise_after=2, clear_after=1))
    for n in range(2):
        book.take(decision(True, n))
    book.take(decision(False, 2))
    book.take(decision(True, 3))
    book.shelve("m1/pump", "kim", 5, "being repaired", T)
    book.take(decision(True, 4))
    assert not book.alarms["m1/pump"].announced
    assert not book.alarms["m1/pump"].active


def test_phoebus_3201_put_aside_until_a_time():
    book = AlarmBook()
    book.take(decision(True))
    book.shelve("m1/pump", "kim", 5, "being repaired", T)
    book.tick(T + 299 * SECOND)
    assert not book.alarms["m1/pump"].announced
    book.tick(T + 300 * SECOND)
    assert book.alarms["m1/pump"].announced


# ---------------------------------------------------------------------------------------------------------------- Tango


def test_cpptango_559_alarms_are_judged_in_every_state():
    """Paused bursts, a burst that plays: what is found is found."""
    paused = desk()
    paused.scheduler.paused, paused.playing = "cleaning", "b1"
    hub, watch, stream = service(paused)
    stream.outcome = Outcome((decision(True).evidence,), (), np.zeros((50, 1)))
    hub._block(watch, codec.encode_block(block()))
    assert hub.alarms.alarms["m1/pump"].active


@pytest.mark.parametrize("thread", ["cpptango_330", "cpptango_555"])
def test_a_value_that_cannot_be_read_is_an_alarm_and_no_crash(thread):
    hub, watch, stream = service()
    stream.outcome = Outcome((), (StreamFinding("bad_samples", "'y_x' is NaN at sample 3"),), None)
    hub._block(watch, codec.encode_block(block()))
    alarm = hub.alarms.alarms["m1/bad_samples"]
    assert alarm.kind is AlarmKind.SYSTEM
    assert alarm.sentence == "'y_x' is NaN at sample 3"
    hub._block(watch, b"\xff not a block")
    assert "could not be read" in watch.sink.of(Notice)[-1].sentence


# ------------------------------------------------------------------------------------------------- ophyd-async, blueapi


@pytest.mark.parametrize("thread", ["ophyd_async_94", "ophyd_async_1103"])
def test_a_driver_that_is_not_there_is_never_replaced_by_a_simulator(plugins, thread):
    config = MachineSection(id="m1", plant="gas_bearing", driver=DriverSection(kind="lab"))
    with pytest.raises(BadInput, match="lab"):
        ports.open_port(commissioning.commission(config, plugins), "s1", FastClock(), plugins)


def test_blueapi_732_everything_runs_on_simulated_machines(simulated):
    port = simulated()
    with port.arm(port._limits) as drive:
        drive.play(SINE)
        while drive.playing:
            assert port.read().burst == "b1"
    assert not port.read().burst


# ----------------------------------------------------------------------------------------------------------------- dora


@pytest.mark.parametrize("thread", ["dora_1225", "dora_1232"])
def test_one_machine_that_fails_does_not_darken_another(thread):
    (_, ill, _), (_, well, _) = service(), service()
    for watch in (ill, well):
        watch.appeared("s1")
        watch.take_block(codec.encode_block(block()))
    ill.clock._seconds = 9.0
    assert (ill.status("", 0.0, ()).state, well.status("", 0.0, ()).state) == ("stale", "running")


@pytest.mark.parametrize("thread", ["dora_2937", "dora_3022"])
def test_a_slow_start_is_not_punished_and_a_start_that_hangs_is_seen(thread):
    """First their watchdog killed slow starters, then hung starters were never noticed."""
    _, watch, _ = service()
    assert watch.status("", 0.0, ()).reason == "no rig agent is connected"
    watch.appeared("s1")
    status = watch.status("", 0.0, ())
    assert (status.state, status.reason) == ("stale", "no block yet")
    watch.clock._seconds = 600.0
    watch.take_block(codec.encode_block(block()))
    assert watch.status("", 0.0, ()).state == "running"


# --------------------------------------------------------------------------------------------------------------- copper


def test_copper_1389_two_sessions_are_never_joined(tmp_path):
    recorder = Recorder(RecordingSettings(tmp_path / "a.mcap"))
    for session in ("s1", "s2"):
        for seq in range(3):
            recorder.block(codec.encode_block(block(seq, session)), block(seq, session))
    recorder.close()
    assert [len(t) for t in Recording(recorder.path).traces("m1")] == [150, 150]


def test_copper_1407_newest_or_all_is_chosen_for_each_channel():
    sent: list[tuple[str, str]] = []
    post, news = (SimpleNamespace(send=lambda key, *a, via=via: sent.append((via, key.split("/")[-1]))) for via in ("all", "newest"))
    publisher = Publisher(Keys("t"), post, news)
    publisher.take(Message(Residual(residual_block(block(), np.zeros((50, 1))))))
    publisher.take(Message(decision(True)))
    book = AlarmBook(tell=lambda change: publisher.take(Message(change)))
    book.take(decision(True))
    assert sent == [("newest", "residual"), ("all", "evidence"), ("all", "alarm")]


# ---------------------------------------------------------------------------------------------------------------- rosys


def test_rosys_435_a_budget_for_the_disk_and_recordings_of_a_crash(tmp_path):
    recorder = Recorder(RecordingSettings(tmp_path / "m1-20261101T120000.mcap"))
    recorder.block(codec.encode_block(block()), block())
    recorder.flush()
    recorder._file.abandon()
    recorder._file = None
    assert not is_finished(recorder.path)
    recover_in_place(recorder.path)
    assert is_finished(recorder.path)
    assert [b.seq for b in Recording(recorder.path).blocks()] == [0]
    assert [r.path for r in tidy(tmp_path, Keep(bytes=100), [], 2e9)] == [recorder.path]


# ------------------------------------------------------------------------------------------------------- our own, found here


def test_a_refused_second_agent_does_not_end_the_burst_of_the_first():
    """Its farewell ("the plant is at rest") once made the service forget the burst, whose lease then ran out."""
    accepted = codec.encode(codec.decode(BurstReply, b"\x08\x01"))
    playing = desk(lambda *a: accepted)
    playing.ask(BurstOrder("kim"))
    playing.heard(RigEvent("m1", "s2", T, EventKind.RIG_STOPPED, 0, "", "the plant is at rest"))
    assert playing.playing
    playing.heard(RigEvent("m1", "s1", T, EventKind.RIG_STOPPED, 0, "", "the plant is at rest"))
    assert not playing.playing


def test_names_of_bursts_stay_apart_when_the_service_is_started_anew():
    clocks = [FastClock(), FastClock(1_700_000_100 * 10**9)]
    names = set()
    for clock in clocks:
        one = desk()
        one.clock = clock
        one.__post_init__()
        one.session = "s1"
        names |= {one._name(), one._name()}
    assert len(names) == 4


