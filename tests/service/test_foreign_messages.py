"""A rig is bound to its key by access rules: what it says of another machine under that key is reported and ignored."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from afdsvc.api.evidence import Evidence
from afdsvc.api.signals import Block, Channel
from afdsvc.diagnosis.pipeline import Outcome
from afdsvc.errors import Refused
from afdsvc.hal.agent import RigAgent
from afdsvc.service.clock import FastClock, RealClock
from afdsvc.service.hub import Hub
from afdsvc.service.machine import MOST_REPORTED, MachineMonitor
from afdsvc.wire import codec
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import BurstStop, EventKind, Finding, Lease, Notice, RigDescription, RigEvent

CHANNELS = (Channel("u_x"), Channel("y_x"))


def monitor() -> tuple[MachineMonitor, list[str], list[object]]:
    said: list[str] = []
    passed: list[object] = []

    def take(message: codec.Message) -> None:
        if isinstance(message.value, Notice):
            said.append(message.value.sentence)
        else:
            passed.append(message.value)

    sink = SimpleNamespace(take=take)
    return MachineMonitor("m1", SimpleNamespace(), sink, RealClock()), said, passed


def block(machine: str) -> bytes:
    return codec.encode_block(Block(machine, "s", 0, 0, 1e-3, 10**18, CHANNELS, np.ones((50, 2))))


def test_blocks_events_and_descriptions_of_another_machine_are_ignored():
    watch, said, passed = monitor()
    assert watch.take_block(block("m2")) is None
    assert watch.take_event(codec.encode(RigEvent("m2", "s", 10**18, EventKind.NOTE))) is None
    watch.take_description(codec.encode(RigDescription("m2", "s", 10**18, 1e-3, CHANNELS, head_room=0.1)))
    assert (passed, watch.blocks, watch.session, watch.head_room) == ([], 0, "", 1.0)
    assert said == ["the rig agent of 'm1' sent a block of machine 'm2'; such messages are ignored"]


def test_a_flood_of_rubbish_is_one_line_a_minute():
    watch, said, passed = monitor()
    for _ in range(1000):
        watch.take_block(b"rubbish")
        watch.take_event(b"rubbish")
        watch.take_description(b"rubbish")
    assert not passed
    assert [sentence.partition(",")[0] for sentence in said] == ["block ignored", "event ignored", "description ignored"]
    assert all("could not be read" in sentence for sentence in said)


def test_a_flood_of_names_is_reported_a_few_times_only():
    watch, said, _ = monitor()
    for i in range(100):
        watch.take_block(block(f"x{i}"))
    assert len(said) == MOST_REPORTED


def test_a_rig_ignores_stops_and_leases_meant_for_another_machine():
    transport = SimpleNamespace(publish=lambda *a: None)
    agent = RigAgent(Keys("t"), RigDescription("m1", "s", 1, 1e-3, CHANNELS), SimpleNamespace(dt=1e-3), transport, FastClock())
    agent._bursts.name = "b"
    with pytest.raises(Refused, match="is for machine 'm2'; this is 'm1'"):
        agent._on_stop(codec.encode(BurstStop("m2", "why", "kim")))
    agent._on_lease("", codec.encode(Lease("m2", "b", 1.0)))
    assert agent._bursts.reason_to_end() == "the lease expired: no renewal from the service"
    agent._on_lease("", codec.encode(Lease("m1", "b", 1.0)))
    assert agent._bursts.reason_to_end() == ""


def test_a_new_session_counts_its_samples_anew_before_its_first_block():
    watch, _, _ = monitor()
    watch.seconds_seen = 369.0
    watch.appeared("new")
    assert watch.seconds_seen == 0.0


def test_what_publishers_send_again_to_a_new_network_session_is_taken_once_and_late_blocks_still_are():
    watch, _, passed = monitor()
    watch.pipeline = SimpleNamespace(step=lambda block: Outcome((), (), None))

    def sent(session: str, seq: int) -> bytes:
        return codec.encode_block(Block("m1", session, seq, 50 * seq, 1e-3, 10**18, CHANNELS, np.ones((50, 2))))

    for session, seq in (("s", 0), ("s", 2), ("s", 0), ("s", 1), ("s", 2), ("t", 0), ("t", 0)):
        watch.take_block(sent(session, seq))
    assert [(b.session, b.seq) for b in passed] == [("s", 0), ("s", 2), ("s", 1), ("t", 0)]


def test_the_notice_that_a_model_is_to_be_doubted_names_a_recording_of_that_machine():
    """It named that of the last machine of the site."""
    watches = {id: MachineMonitor(id, None, SimpleNamespace(take=lambda message: None), FastClock()) for id in ("m1", "m2")}
    files = [Path(f"{id}-20261101T120000{part}") for id in watches for part in (".mcap", ".0001.mcap", ".rrd")]
    hub = Hub(Keys("t"), "1", watches, {}, None, FastClock(), lambda: ("", 0, "", 0), lambda: files)
    doubtful = [Evidence("d", "m1", n, 0.0, 1.0, 2.0, False, f"b{n}", trustworthy=False, reason="coloured", p_white=1e-6) for n in range(3)]
    watches["m1"].findings.extend(Finding(e, "s", 0) for e in doubtful)
    hub._sum_up(watches["m1"], 0)
    assert "'afdsvc explain m1-20261101T120000.0001.mcap'" in watches["m1"].doubt
