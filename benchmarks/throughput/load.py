"""Many machines in one process: ``python benchmarks/throughput/load.py SITE.toml SECONDS`` publishes their blocks at 5 kHz.

Accepts bursts as a rig agent does and plays them. Prints one line of JSON at the end: blocks sent, how late the worst one
was, and for every decision on a burst the time from the burst's last sample to its arrival here.
"""

from __future__ import annotations

import heapq
import json
import sys
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

from machine import LENGTH, Signals, Talker, commissioned

from afdsvc.files.site import Site, read_site
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire import codec
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import BurstReply, BurstRequest, EventKind, Finding, RigDescription, RigEvent

PER_SESSION = 10  # machines on one connection


@dataclass
class Load:
    """Everything of one run; zenoh threads only leave requests for the loop."""

    site: Site
    asked: deque[BurstRequest] = field(default_factory=deque)
    latencies: list[float] = field(default_factory=list)
    ends: dict[str, float] = field(default_factory=dict)
    worst: float = 0.0
    sent: int = 0
    bursts: int = 0

    def __post_init__(self) -> None:
        machine = commissioned(self.site)
        self.keys, self.machine = Keys(self.site.site), machine
        self.signals = Signals(machine)
        ids = [m.id for m in self.site.machines]
        step = len(self.signals.bodies) / len(ids)
        self.talkers = {id: Talker(id, f"s{id}", self.signals, round(i * step)) for i, id in enumerate(ids)}
        self.waiting: dict[str, BurstRequest] = {}
        sessions = [Transport(self.site.transport, False) for _ in range(0, len(ids), PER_SESSION)]
        for session in sessions:
            session.open()
        self.sessions = sessions
        self.lines = {id: sessions[i // PER_SESSION] for i, id in enumerate(ids)}
        sessions[0].subscribe(self.keys.evidences(), self._decided, missed=False)
        for id, line in self.lines.items():
            line.serve(self.keys.burst(id), self._on_burst)
            line.announce(self.keys.alive(id, f"s{id}"))

    def _on_burst(self, payload: bytes) -> bytes:
        request = codec.decode(BurstRequest, payload)
        self.asked.append(request)
        return codec.encode(BurstReply(True, request.burst.name))

    def _decided(self, _key: str, payload: bytes) -> None:
        end = self.ends.get(codec.decode(Finding, payload).evidence.burst)
        if end is not None:
            self.latencies.append(time.time() - end)

    def run(self, seconds: float) -> None:
        """Send every block when its last sample would have been taken."""
        dt = self.signals.dt * LENGTH
        began = time.time()
        due = [(began + dt * (i / len(self.talkers)), id) for i, id in enumerate(self.talkers)]
        heapq.heapify(due)
        while due[0][0] < began + seconds:
            moment, id = due[0]
            while self.asked:
                request = self.asked.popleft()
                self.waiting[request.machine] = request
            late = time.time() - moment
            if late < 0:
                time.sleep(-late)
            self.worst = max(self.worst, late)
            self._say(self.talkers[id], moment)
            heapq.heapreplace(due, (moment + dt, id))

    def _say(self, talker: Talker, moment: float) -> None:
        line, k = self.lines[talker.id], talker.seq * LENGTH
        request = self.waiting.get(talker.id)
        if request is not None and k >= request.start:
            del self.waiting[talker.id]
            talker.play(request.burst)
            self.bursts += 1
            line.publish(self.keys.event(talker.id), self._event(talker, EventKind.BURST_STARTED, request.burst.name))
        line.publish(self.keys.block(talker.id), talker.next(round((moment - self.signals.dt * LENGTH) * 1e9)))
        self.sent += 1
        burst = talker.burst
        if burst is not None and (talker.seq - talker.began) * LENGTH == burst.samples:
            self.ends[burst.name] = moment
            line.publish(self.keys.event(talker.id), self._event(talker, EventKind.BURST_ENDED, burst.name))

    def _event(self, talker: Talker, kind: EventKind, burst: str) -> bytes:
        return codec.encode(RigEvent(talker.id, talker.session, time.time_ns(), kind, talker.seq * LENGTH, burst))

    def describe(self) -> None:
        """Tell what each machine is, as a rig does."""
        for id, line in self.lines.items():
            reported = RigDescription(id, f"s{id}", time.time_ns(), self.signals.dt, self.machine.channels, self.machine.limits)
            line.publish(self.keys.description(id), codec.encode(reported))


def main() -> None:
    """Run and print."""
    site, seconds = read_site(Path(sys.argv[1])), float(sys.argv[2])
    sys.setswitchinterval(5e-4)
    load = Load(site)
    load.describe()
    load.run(seconds)
    print("sent", flush=True)
    sys.stdin.readline()  # the service's counters are read before the machines vanish
    reported = {"sent": load.sent, "worst_late_s": load.worst, "bursts": load.bursts, "latencies_s": sorted(load.latencies)}
    print(json.dumps(reported), flush=True)
    closing = [threading.Thread(target=session.close) for session in load.sessions]
    for thread in closing:
        thread.start()
    for thread in closing:  # a session that closes while the interpreter ends would abort it
        thread.join()


if __name__ == "__main__":
    main()
