"""After an interruption more comes at once than the worker's queue holds: the rigs wait, and nothing is lost."""

from __future__ import annotations

import socket
import threading
import time

from afdsvc.files.site import TransportSection as Settings
from afdsvc.service.clock import RealClock
from afdsvc.service.hub import Hub
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire.keys import Keys


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
        line.publish = lambda *_, **__: None  # the status of this machine cannot be told
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
