"""After an interruption more comes at once than the worker's queue holds: the rigs wait, and nothing is lost."""

from __future__ import annotations

import re
import socket
import threading
import time
from types import SimpleNamespace

from afdsvc.files.site import TransportSection as Settings
from afdsvc.service.clock import RealClock
from afdsvc.service.hub import BEHIND_SECONDS, Hub
from afdsvc.transport.zenoh_session import Transport
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


def test_a_judgement_that_stands_still_is_in_the_status_while_it_does():
    watch, free = SlowWatch(), threading.Event()
    watch.take_block = lambda payload: free.wait(10) and None
    watch.status = lambda *_: MachineStatus(
        "m1", "running", "s", "the model misses something", 0, 0, 0, 0.0, 0.0, "", 0.0, True, ()
    )
    line = SimpleNamespace(
        subscribe=lambda *_: None, watch=lambda *_: None, announce=lambda *_: None, publish=lambda *_, **__: None
    )
    hub = Hub(Keys("t"), "0", {"m1": watch}, {}, line, RealClock(), lambda: ("", 0, "", 0))
    hub.start()
    try:
        for _ in range(4):
            hub._put("block", Keys("t").block("m1"), b"")
        time.sleep(BEHIND_SECONDS + 0.5)
        status = hub.status()
    finally:
        free.set()
        hub.stop()
    assert re.fullmatch("judgement is [2-5] s behind, 3 messages wait; the model misses something", status.machines[0].reason)
    assert status.longest_waits["judgement"] > BEHIND_SECONDS
    assert hub.behind() == 0
