"""The rig agent: runs a port, publishes its blocks, plays bursts within its limits, and obeys nobody else."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field, replace

from afdsvc.api.bursts import Limits
from afdsvc.api.clock import Clock
from afdsvc.api.port import DrivablePort, Drive, Port
from afdsvc.api.signals import Block
from afdsvc.errors import AfdsvcError, Refused
from afdsvc.runtime.transport import Transport
from afdsvc.wire import codec
from afdsvc.wire.keys import Keys, session_of
from afdsvc.wire.messages import BurstReply, BurstRequest, BurstStop, EventKind, Lease, RigDescription, RigEvent

HEARTBEAT_SECONDS = 2.0
LONGEST_LEAD_SECONDS = 10.0


@dataclass
class Watchdog:
    """The asker's word that it is still there; a burst fades out when that word has expired or the service is gone."""

    clock: Clock
    until: float = float("-inf")
    service_gone: bool = False

    def renew(self, seconds: float) -> None:
        """Extend the lease from now on."""
        self.until, self.service_gone = self.clock.monotonic() + seconds, False

    def expired(self) -> str:
        """Return why the burst must end, "" while the lease holds."""
        if self.service_gone:
            return "the service vanished"
        return "the lease ran out: the service was silent" if self.clock.monotonic() > self.until else ""


@dataclass
class RigAgent:
    """One machine on the wire. `run` is the control thread; zenoh threads only leave requests for it.

    ``truth`` lists what a simulator injects as (sample, sentence); it is told when it happens.
    """

    keys: Keys
    description: RigDescription
    port: Port
    transport: Transport
    clock: Clock
    truth: list[tuple[int, str]] = field(default_factory=list)
    stopping: threading.Event = field(default_factory=threading.Event)

    def __post_init__(self) -> None:
        self._lock = threading.Lock()
        self.truth = sorted(self.truth)
        self._pending: BurstRequest | None = None
        self._watchdog = Watchdog(self.clock)
        self._playing = self._halt = ""
        self._told_late = 0
        self._next_beat = float("-inf")
        self._k = 0

    @property
    def machine(self) -> str:
        """Id of the machine."""
        return self.description.machine

    @property
    def limits(self) -> Limits | None:
        """Limits of the machine; None when it can only be watched."""
        return self.description.limits

    def run(self, seconds: float | None = None) -> None:
        """Serve until `stopping` is set, the port ends, or the seconds have passed; the port is always closed."""
        try:
            self._refuse_twin()
            self._open_doors()
            self._event(EventKind.RIG_STARTED, f"{1 / self.port.dt:g} Hz, {self.description.driver}")
            self._loop(seconds)
        finally:
            self.port.close()
            self._event(EventKind.RIG_STOPPED, "the plant is at rest")

    def _refuse_twin(self) -> None:
        for token in self.transport.alive(self.keys.sessions(self.machine)):
            if session_of(token) != self.description.session:
                raise Refused(f"machine '{self.machine}' has a rig agent already (session {session_of(token)})")

    def _open_doors(self) -> None:
        t, keys = self.transport, self.keys
        t.serve(keys.burst(self.machine), self._on_burst)
        t.serve(keys.stop(self.machine), self._on_stop)
        t.serve(keys.description(self.machine), lambda _: codec.encode_description(self.description))
        t.subscribe(keys.lease(self.machine), self._on_lease)
        t.watch(keys.service_alive(), self._on_service)
        t.announce(keys.alive(self.machine, self.description.session))

    def _loop(self, seconds: float | None) -> None:
        while not self.stopping.is_set() and (seconds is None or self._k * self.port.dt < seconds):
            request = self._take()
            if request is not None:
                self._play(request)
            elif not self._pump():
                return

    def _pump(self) -> bool:
        """Pass one block on; return whether there was one."""
        block = self.port.read()
        if block is None:
            return False
        self._publish(block)
        return True

    def _publish(self, block: Block) -> None:
        self._k = block.k0 + len(block)
        while self.truth and self.truth[0][0] <= self._k:
            self._event(EventKind.FAULT_INJECTED, self.truth.pop(0)[1])
        self.transport.publish(self.keys.block(self.machine), codec.encode_block(block))
        if self.clock.monotonic() >= self._next_beat:
            self._next_beat = self.clock.monotonic() + HEARTBEAT_SECONDS
            self._beat()

    def _beat(self) -> None:
        status = self.port.status()
        now = replace(self.description, samples=status.samples, late=status.late, head_room=status.head_room)
        self.transport.publish(self.keys.description(self.machine), codec.encode_description(now))
        if status.late > self._told_late:
            self._event(EventKind.NOTE, f"{status.late - self._told_late} control samples missed their deadline")
            self._told_late = status.late

    def _play(self, request: BurstRequest) -> None:
        """Play one burst; whatever happens, the port is disarmed afterwards and the end is told."""
        name = request.burst.name
        kind, cause = EventKind.BURST_ABORTED, "the rig agent failed"
        try:
            cause = self._drive(request)
            kind = EventKind.BURST_ABORTED if cause else EventKind.BURST_ENDED
        except Refused as refusal:
            kind, cause = EventKind.BURST_REFUSED, str(refusal)
        finally:
            with self._lock:
                self._playing = ""
            self._event(kind, cause, name)

    def _drive(self, request: BurstRequest) -> str:
        """Arm, play, watch; return why the burst ended early, "" when it did not."""
        port, limits = self.port, self.limits
        if not isinstance(port, DrivablePort) or limits is None:
            raise Refused("this machine can be watched, not excited")
        with port.arm(limits) as drive:
            drive.play(request.burst)
            self._event(EventKind.BURST_STARTED, f"asked by {request.asked_by}", request.burst.name)
            while drive.playing:
                self._watch(drive)
                self._pump()
            return drive.aborted

    def _watch(self, drive: Drive) -> None:
        leaving = "the rig agent was asked to stop" if self.stopping.is_set() else ""
        reason = leaving or self._halt or self._watchdog.expired()
        if reason and not drive.aborted:
            drive.stop(reason)

    def _take(self) -> BurstRequest | None:
        """Return the request whose first sample has come."""
        with self._lock:
            if self._pending is None or self._k < self._pending.start:
                return None
            request, self._pending = self._pending, None
            return request

    def _on_burst(self, payload: bytes) -> bytes:
        """Accept or refuse; runs in a zenoh thread, so it only checks and leaves the request behind."""
        try:
            request = codec.decode_burst_request(payload)
            with self._lock:
                self._refuse(request)
                self._pending, self._playing, self._halt = request, request.burst.name, ""
                self._watchdog.renew(request.lease)
        except AfdsvcError as refusal:
            self._event(EventKind.BURST_REFUSED, str(refusal))
            return codec.encode_burst_reply(BurstReply(False, reason=str(refusal)))
        return codec.encode_burst_reply(BurstReply(True, request.burst.name))

    def _refuse(self, request: BurstRequest) -> None:
        if not isinstance(self.port, DrivablePort) or self.limits is None:
            raise Refused(f"machine '{self.machine}' can be watched, not excited")
        if self._playing:
            raise Refused(f"burst '{self._playing}' is playing; two at once are never played")
        if request.machine != self.machine:
            raise Refused(f"the request is for machine '{request.machine}'; this is '{self.machine}'")
        if self._watchdog.service_gone:
            raise Refused("the service is not there; nobody would watch the burst")
        if (request.start - self._k) * self.port.dt > LONGEST_LEAD_SECONDS:
            raise Refused(f"the burst is to start at sample {request.start}; it is {self._k} now, which is too far ahead")
        self.port.check(request.burst, self.limits)

    def _on_stop(self, payload: bytes) -> bytes:
        stop: BurstStop = codec.decode_burst_stop(payload)
        if not self._playing or stop.burst not in ("", self._playing):
            return codec.encode_burst_reply(BurstReply(False, stop.burst, "no such burst is playing"))
        self._halt = f"stopped by {stop.asked_by}: {stop.reason}"
        return codec.encode_burst_reply(BurstReply(True, self._playing))

    def _on_lease(self, _key: str, payload: bytes) -> None:
        lease: Lease = codec.decode_lease(payload)
        if lease.burst == self._playing:
            self._watchdog.renew(lease.seconds)

    def _on_service(self, _key: str, alive: bool) -> None:
        self._watchdog.service_gone = not alive

    def _event(self, kind: EventKind, cause: str, burst: str = "") -> None:
        event = RigEvent(self.machine, self.description.session, self.clock.now_ns(), kind, self._k, burst, cause)
        self.transport.publish(self.keys.event(self.machine), codec.encode_event(event))
