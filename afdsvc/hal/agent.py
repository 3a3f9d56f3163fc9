"""The rig agent: runs a port, publishes its blocks, and plays bursts within its limits."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from afdsvc.api.bursts import Limits
from afdsvc.api.clock import Clock
from afdsvc.api.port import DrivablePort, Drive, Port, SimulatedPort, TunablePort
from afdsvc.api.signals import Block
from afdsvc.errors import AfdsvcError, Refused
from afdsvc.hal.lease import Grant, refuse_long
from afdsvc.hal.store import Store
from afdsvc.transport.freshness import FRESH_SECONDS, Freshness
from afdsvc.transport.outgoing_queue import OutgoingQueue
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire import codec
from afdsvc.wire.keys import Keys, session_of
from afdsvc.wire.messages import (
    BurstReply,
    BurstRequest,
    BurstStop,
    Command,
    EventKind,
    Lease,
    Receipt,
    RetuneRequest,
    RigDescription,
    RigEvent,
)

log = logging.getLogger(__name__)
HEARTBEAT_SECONDS = 2.0
FORWARD_SECONDS = 0.25  # between two looks at the store
MOST_EARLY = 1000  # events that wait for the network; later ones go first
LONGEST_LEAD_SECONDS = 10.0
EMERGENCY = "emergency stop by signal; bursts are refused until the rig agent is started again"


@dataclass
class RigAgent:
    """One machine on the wire. `run` is the control thread; zenoh threads only leave requests for it.

    Nothing the control thread does waits for the network. Setting ``emergency`` (from a signal handler, say) silences alpha
    at the next block and refuses every later burst. ``truth`` lists what a simulator injects as (sample, sentence); it is
    reported when it happens. ``patient`` is for a port that is not in real time: it waits rather than lose blocks. ``connect``
    waits until the network is there (or the event is set); control goes on meanwhile. Without it the network is there. ``store``
    keeps the blocks that the service does not acknowledge.
    """

    keys: Keys
    description: RigDescription
    port: Port
    transport: Transport
    clock: Clock
    truth: list[tuple[int, str]] = field(default_factory=list)
    stopping: threading.Event = field(default_factory=threading.Event)
    emergency: threading.Event = field(default_factory=threading.Event)
    patient: bool = False
    connect: Callable[[threading.Event], None] | None = None
    store: Store | None = None

    def __post_init__(self) -> None:
        self._joined = threading.Event()
        self._early: deque[tuple[str, bytes]] = deque(maxlen=MOST_EARLY)
        ready, publish = (self._joined, self.transport.publish) if self.store is None else (None, self._send)
        self._post = OutgoingQueue(publish, f"post of {self.description.machine}", patient=self.patient, ready=ready)
        self._over = threading.Event()
        self._emergency_reported = False
        self._twin: Refused | None = None
        self.truth = sorted(self.truth)
        self._bursts = Grant[BurstRequest](self.clock, "a burst", "burst '{}' is playing; only one burst is played at a time")
        self._qs = Grant[RetuneRequest](self.clock, "Q", "another Q acts; restore the machine first")
        self._freshness, self._tuned = Freshness(self.clock), ""
        self._reported_late = self._reported_dropped = 0
        self._next_beat = float("-inf")
        self._k = 0

    @property
    def machine(self) -> str:
        """Id of the machine."""
        return self.description.machine

    @property
    def playing(self) -> bool:
        """Whether a burst plays or is about to."""
        return bool(self._bursts.name)

    @property
    def limits(self) -> Limits | None:
        """Limits of the machine; None when it can only be watched."""
        return self.description.limits

    def run(self, seconds: float | None = None) -> None:
        """Serve until `stopping` is set, the port ends, or the seconds have passed; the port is always closed.

        Raises `Refused` when the machine has a rig agent already.
        """
        joining = threading.Thread(target=self._join_late, name=f"connection of {self.machine}", daemon=True)
        storing = threading.Thread(target=self._forward, name=f"store of {self.machine}", daemon=True)
        if self.store is not None:
            storing.start()
        try:
            if self.connect is None:
                self._join()
            else:
                joining.start()
            try:
                self._loop(seconds)
            finally:
                self._rest()
        finally:
            self.port.close()
            self._post.close()
            if self.store is not None:
                self._over.set()
                storing.join(3)
            if self.connect is not None:  # also after a failure of the machine, which must not wait for the network
                self.stopping.set()
                joining.join(3)
        if self._twin is not None:
            raise self._twin

    def _join(self) -> None:
        self._refuse_twin()
        self._open_doors()
        self._event(EventKind.RIG_STARTED, f"{1 / self.port.dt:g} Hz, {self.description.driver}")
        self._joined.set()  # what was measured before is sent now

    def _send(self, key: str, payload: bytes) -> None:
        """Send a message; before the network is there, events wait for it and blocks are in the store."""
        if not self._joined.is_set():
            if key != self.keys.block(self.machine):
                self._early.append((key, payload))
            return
        while self._early:
            self.transport.publish(*self._early.popleft())
        self.transport.publish(key, payload)

    def _forward(self) -> None:
        """Look after the store until the agent ends."""
        assert self.store is not None  # noqa: S101 - the thread is started only then
        while not self._over.wait(FORWARD_SECONDS):
            try:
                self.store.tick(lambda data: self.transport.ask(self.keys.stored(self.machine), data))
                for session, ranges in self.store.statement().items() if self.store.acknowledged else ():
                    lost = ", ".join(f"{start} to {end - 1}" for start, end in ranges)
                    self._event(EventKind.NOTE, f"samples {lost} of session {session} could not be kept: the store was full or failed")
            except AfdsvcError as error:
                log.debug("what is stored cannot be delivered now: %s", error)
            except Exception:
                log.exception("the store of '%s' failed", self.machine)
        self.store.close()

    def _on_receipt(self, _key: str, payload: bytes) -> None:
        receipt = codec.decode(Receipt, payload)
        if self.store is not None and receipt.machine == self.machine:
            self.store.receive(receipt)

    def _join_late(self) -> None:
        assert self.connect is not None  # noqa: S101 - the thread is started only then
        self.connect(self.stopping)
        if self.stopping.is_set():
            return
        try:
            self._join()
        except Refused as twin:
            self._twin = twin
            self.stopping.set()

    def _rest(self) -> None:
        """Close the port and report it, also when that fails."""
        try:
            self.port.close()
        except Exception as error:
            self._event(EventKind.RIG_STOPPED, f"the plant could not be brought to rest: {type(error).__name__}: {error}")
            raise
        self._event(EventKind.RIG_STOPPED, "the plant is at rest")

    def _refuse_twin(self) -> None:
        for token in self.transport.alive(self.keys.sessions(self.machine)):
            if session_of(token) != self.description.session:
                raise Refused(f"machine '{self.machine}' has a rig agent already (session {session_of(token)})")

    def _open_doors(self) -> None:
        t, keys = self.transport, self.keys
        t.serve(keys.burst(self.machine), self._on_burst)
        t.serve(keys.stop(self.machine), self._on_stop)
        t.serve(keys.retune(self.machine), self._on_retune)
        t.serve(keys.restore(self.machine), self._on_restore)
        t.serve(keys.inject(self.machine), self._on_inject)
        t.serve(keys.description(self.machine), lambda _: codec.encode(self.description))
        t.subscribe(keys.lease(self.machine), self._on_lease, missed=False)
        if self.store is not None:
            t.subscribe(keys.receipt(self.machine), self._on_receipt, missed=False)
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
        self._begin_q()
        block = self.port.read()
        if block is None:
            return False
        self._publish(block)
        self._end_q()
        return True

    def _begin_q(self) -> None:
        """Let the Q act that was accepted."""
        request = self._qs.take()
        if request is None or not isinstance(self.port, TunablePort):
            return
        try:
            self.port.retune(request.tuning, partial(self._reason_to_end, self._qs), request.name)
        except Refused as refusal:
            self._qs.end()
            self._event(EventKind.RETUNE_REFUSED, str(refusal), request.name)
        else:
            self._tuned = request.name
            self._event(EventKind.RETUNED, f"accepted by {request.asked_by}: {request.proof}", request.name)

    def _end_q(self) -> None:
        """Report a Q that has gone, with its reason."""
        port, name = self.port, self._tuned
        if name and isinstance(port, TunablePort) and port.restored_because and port.retuned == 0:
            self._tuned = ""
            self._qs.end()
            self._event(EventKind.RESTORED, port.restored_because, name)

    def _publish(self, block: Block) -> None:
        self._k = block.k0 + len(block)
        while self.truth and self.truth[0][0] <= self._k:
            self._event(EventKind.FAULT_INJECTED, self.truth.pop(0)[1])
        encode = codec.encode_block if self.store is None else self.store.encode
        self._post.send(self.keys.block(self.machine), encode, block)
        if self.emergency.is_set() and not self._emergency_reported:
            self._emergency_reported = True
            self._event(EventKind.NOTE, EMERGENCY)
        if self.clock.monotonic() >= self._next_beat:
            self._next_beat = self.clock.monotonic() + HEARTBEAT_SECONDS
            self._beat()

    def _beat(self) -> None:
        status = self.port.status()
        now = replace(self.description, samples=status.samples, late=status.late, head_room=status.head_room)
        self._post.send(self.keys.description(self.machine), codec.encode, now)
        if status.late > self._reported_late:
            self._event(EventKind.NOTE, f"{status.late - self._reported_late} control samples missed their deadline")
            self._reported_late = status.late
        dropped = self._post.dropped
        if dropped > self._reported_dropped:
            self._event(EventKind.NOTE, f"{dropped - self._reported_dropped} messages could not be sent: the network stalled")
            self._reported_dropped = dropped

    def _play(self, request: BurstRequest) -> None:
        """Play one burst; the port is always disarmed afterwards and the end reported."""
        name = request.burst.name
        kind, cause = EventKind.BURST_ABORTED, "the rig agent failed"
        try:
            cause = self._drive(request)
            kind = EventKind.BURST_ABORTED if cause else EventKind.BURST_ENDED
        except Refused as refusal:
            kind, cause = EventKind.BURST_REFUSED, str(refusal)
        finally:
            self._bursts.end()
            self._event(kind, cause, name)

    def _drive(self, request: BurstRequest) -> str:
        """Arm, play, watch; return why the burst ended early, "" when it did not."""
        port, limits, reason = self.port, self.limits, self._reason_to_end(self._bursts)
        if not isinstance(port, DrivablePort) or limits is None:
            raise Refused("this machine can be watched, not excited")
        if reason:
            raise Refused(f"{reason}, before the first sample")
        with port.arm(limits) as drive:
            drive.play(request.burst)
            self._event(EventKind.BURST_STARTED, request.asked_by, request.burst.name)
            while drive.playing:
                if self.emergency.is_set():
                    return EMERGENCY  # leaving the block cuts alpha off in the next sample
                self._watch(drive)
                self._pump()
            return drive.aborted

    def _watch(self, drive: Drive) -> None:
        reason = self._reason_to_end(self._bursts)
        if reason and not drive.aborted:
            drive.stop(reason)

    def _reason_to_end(self, grant: Grant[Any]) -> str:
        """Return why no burst, or no Q, may act now, "" while one may: starting needs a fresh lease, and so does going on."""
        if self.emergency.is_set():
            return EMERGENCY
        return "the rig agent was asked to stop" if self.stopping.is_set() else grant.reason_to_end()

    def _take(self) -> BurstRequest | None:
        """Return the request whose first sample has come."""
        pending = self._bursts.pending
        return None if pending is None or self._k < pending.start else self._bursts.take()

    def _on_burst(self, payload: bytes) -> bytes:
        return self._granted(self._bursts, BurstRequest, payload, self._check, EventKind.BURST_REFUSED)

    def _on_retune(self, payload: bytes) -> bytes:
        return self._granted(self._qs, RetuneRequest, payload, self._check_q, EventKind.RETUNE_REFUSED)

    def _granted(self, grant: Grant[Any], kind: type[Any], payload: bytes, check: Callable[[Any], None], refused: EventKind) -> bytes:
        """Accept or refuse; runs in a zenoh thread, so it only checks, and leaves the request to the control thread, which never waits for that."""
        name = ""
        try:
            request = codec.decode(kind, payload)
            name = request.burst.name if isinstance(request, BurstRequest) else request.name
            self._refuse(request)
            grant.reserve(name, request.lease)
            try:
                check(request)
            except BaseException:
                grant.end()
                raise
            grant.give(request, request.lease)
        except Exception as error:
            reason = str(error) if isinstance(error, AfdsvcError) else f"the request could not be checked: {type(error).__name__}: {error}"
            self._event(refused, reason, name)
            return codec.encode(BurstReply(False, name, reason))
        return codec.encode(BurstReply(True, name))

    def _refuse(self, request: BurstRequest | RetuneRequest) -> None:
        self._refuse_stale(request)
        self._freshness.refuse_repeated(codec.encode(request))
        if self.emergency.is_set():
            raise Refused(EMERGENCY)
        self._refuse_other(request.machine)

    def _check(self, request: BurstRequest) -> None:
        if (request.start - self._k) * self.port.dt > LONGEST_LEAD_SECONDS:
            raise Refused(f"the burst is to start at sample {request.start}; it is {self._k} now, which is too far ahead")
        if not isinstance(self.port, DrivablePort) or self.limits is None:
            raise Refused(f"machine '{self.machine}' can be watched, not excited")
        self.port.check(request.burst, self.limits)

    def _check_q(self, request: RetuneRequest) -> None:
        if not isinstance(self.port, TunablePort):
            raise Refused(f"the driver of machine '{self.machine}' runs no Q beside its controller")
        self.port.check_tuning(request.tuning)

    def _refuse_stale(self, request: BurstRequest | RetuneRequest) -> None:
        """Refuse a request of long ago: by this session's samples, which no clock moves, or else by its time stamp."""
        if not request.session:
            return self._freshness.refuse_old(request.t_ns)
        if request.session != self.description.session:
            raise Refused(f"the request is for session '{request.session[:64]}' of this rig agent; this is '{self.description.session}'")
        age = (self._k - request.k) * self.port.dt
        if age > FRESH_SECONDS:
            raise Refused(f"the request is {age:.0f} s old by the samples since; at most {FRESH_SECONDS:g} s are accepted")

    def _refuse_other(self, machine: str) -> None:
        if machine != self.machine:
            raise Refused(f"the request is for machine '{machine}'; this is '{self.machine}'")

    def _on_stop(self, payload: bytes) -> bytes:
        return self._stopped(self._bursts, payload, "stopped", "no such burst is playing")

    def _on_restore(self, payload: bytes) -> bytes:
        return self._stopped(self._qs, payload, "restored", f"no Q acts on machine '{self.machine}'")

    def _on_inject(self, payload: bytes) -> bytes:
        """Put a fault into a simulated machine; it is reported with the next block, as of a fault of the site file."""
        asked: Command = codec.decode(Command, payload)
        fault, severity = str(asked.arguments.get("fault")), float(asked.arguments.get("severity") or 0.0)
        if not isinstance(self.port, SimulatedPort):
            raise Refused(f"machine '{self.machine}' is not simulated: nothing can be injected into it")
        self.port.inject(fault, severity)
        self.truth.insert(0, (0, f"{fault} {severity:g}"))
        return codec.encode(BurstReply(True, fault))

    def _stopped(self, grant: Grant[Any], payload: bytes, verb: str, otherwise: str) -> bytes:
        """End what acts or is about to; runs in a zenoh thread, the control thread sees it at its next slice or block."""
        stop: BurstStop = codec.decode(BurstStop, payload)
        self._refuse_other(stop.machine)
        name = grant.stop(stop.burst, f"{verb} by {stop.asked_by}: {stop.reason}")
        return codec.encode(BurstReply(bool(name), name or stop.burst, "" if name else otherwise))

    def _on_lease(self, _key: str, payload: bytes) -> None:
        lease: Lease = codec.decode(Lease, payload)
        refuse_long(lease.seconds)
        if lease.machine == self.machine:
            self._bursts.renew(lease.burst, lease.seconds)
            self._qs.renew(lease.burst, lease.seconds)

    def _on_service(self, _key: str, alive: bool) -> None:
        self._bursts.service_gone = self._qs.service_gone = not alive

    def _event(self, kind: EventKind, cause: str, burst: str = "") -> None:
        event = RigEvent(self.machine, self.description.session, self.clock.now_ns(), kind, self._k, burst, cause)
        log.info("%s: %s%s%s", self.machine, kind.replace("_", " "), f" {burst}" * bool(burst), f": {cause}" * bool(cause))
        self._post.send(self.keys.event(self.machine), codec.encode, event)
