"""After an interruption more comes at once than the worker's queue holds: the rigs wait, and nothing is lost."""

from __future__ import annotations

import re
import socket
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from afdsvc.api.signals import Block, Channel
from afdsvc.errors import Refused
from afdsvc.files.site import TransportSection as Settings
from afdsvc.service.clock import RealClock
from afdsvc.service.hub import BEHIND_SECONDS, Hub
from afdsvc.service.recorder_sink import Receipts
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire.block_codec import encode_block
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import MachineStatus


class SlowWatch:
    """Takes a hundredth of a second for every message and remembers all."""

    machine, present, blocks, session, doubt, seconds_seen = "m1", True, 0, "s", "", 0.0

    def __init__(self) -> None:
        self.seen: list[bytes] = []

    def take_block(self, payload: bytes) -> None:
        time.sleep(0.01)
        self.seen.append(payload)

    def appeared(self, session: str) -> None:
        pass

    gone = appeared


def test_a_backlog_larger_than_the_queue_is_worked_off_without_loss():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        settings = Settings(listen=[f"tcp/127.0.0.1:{s.getsockname()[1]}"])
    keys, watch = Keys("t"), SlowWatch()
    with Transport(settings, hub=True) as line, Transport(settings, hub=False) as rig:
        hub = Hub(keys, "0", {"m1": watch}, {}, line, RealClock(), lambda: ("", 0, "", 0), queue_size=20)
        line.publish = lambda *_, **__: None  # the status of this machine cannot be reported
        hub.start()
        sender = threading.Thread(target=lambda: [rig.publish(keys.block("m1"), bytes([i % 256]) * 20_000) for i in range(300)])
        sender.start()
        deadline = time.monotonic() + 30
        while len(watch.seen) < 300 and time.monotonic() < deadline:
            time.sleep(0.05)
        sender.join()
        hub.status = lambda: None
        hub.stop()
    assert hub.dropped == 0
    assert [p[0] for p in watch.seen] == [i % 256 for i in range(300)]


@pytest.fixture
def standing_still():
    """A hub whose judgement of the first of four messages does not end before the event is set, and the sink of what rigs kept."""
    watch, free, taken = SlowWatch(), threading.Event(), []
    watch.take_block = lambda payload: free.wait(10) and None
    watch.status = lambda *_: MachineStatus(
        "m1", "running", "s", "the model misses something", 0, 0, 0, 0.0, 0.0, "", 0.0, True, ()
    )
    names = ("subscribe", "watch", "announce", "publish", "serve")
    line = SimpleNamespace(**dict.fromkeys(names, lambda *_, **__: None))
    late = {"m1": (Receipts(), SimpleNamespace(take=taken.append))}
    hub = Hub(Keys("t"), "0", {"m1": watch}, {}, line, RealClock(), lambda: ("", 0, "", 0), late=late)
    hub.start()
    try:
        for _ in range(4):
            hub._put("block", Keys("t").block("m1"), b"")
        time.sleep(BEHIND_SECONDS + 0.5)
        yield hub, free, taken
    finally:
        free.set()
        hub.stop()


def test_a_judgement_that_stands_still_is_in_the_status_while_it_does(standing_still):
    hub, free, _ = standing_still
    status = hub.status()
    free.set()
    hub.drain()
    assert re.fullmatch("judgement is [2-5] s behind, 3 messages wait; the model misses something", status.machines[0].reason)
    assert status.longest_waits["judgement"] > BEHIND_SECONDS
    assert hub.behind() == 0


def test_what_rigs_kept_waits_while_judgement_is_behind(standing_still):
    """What waits in the queue is recorded when it is judged: taken from the rig's store too, it would cost twice and hold up the queue."""
    hub, free, taken = standing_still
    kept = encode_block(Block("m1", "s", 0, 0, 1e-3, 0, (Channel("u_x"),), np.zeros((5, 1))))
    with pytest.raises(Refused, match=r"judgement is [2-5] s behind; what a rig keeps is taken when it has caught up"):
        hub._take_stored("m1", kept)
    assert taken == []
    free.set()
    hub.drain()
    assert hub._take_stored("m1", kept) == b"taken"
    assert [m.payload for m in taken] == [kept]
