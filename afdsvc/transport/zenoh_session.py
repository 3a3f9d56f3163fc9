"""zenoh sessions: loopback by default, no loss in a stall, always closed.

Settings follow what was measured with eclipse-zenoh 1.10. Advanced publishers with a cache and recovery survive a subscriber
that stalls for 8 s without loss (with zenoh's own lease of 10 s; a shorter one cuts the link in the stall). Shared memory
leaves files behind when a process is killed, so it is off. A session that is not closed hangs the interpreter, so a
`Transport` is a context manager.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import zenoh
from zenoh import ext

from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.files import site as site_file
from afdsvc.transport.access_rules import NOBODY, Access
from afdsvc.transport.certificates import key_files

log = logging.getLogger(__name__)
CLOSING_SECONDS = 2.0
HEARD_SECONDS = 0.5
REPORT_SECONDS = 60.0  # between two reports of messages that cannot be read
AGAIN_SECONDS = 0.2  # between two attempts to connect
HALF_OPEN = 4000  # connections that have not said anything yet (zenoh gives each 10 s): a stranger's do not keep rigs out
Receive = Callable[[str, bytes], None]
Answer = Callable[[bytes], bytes]


class NoPeer(BadInput):
    """The session could not be opened: no listener there, or the address is in use."""


class PeerSilent(AfdsvcError):
    """No answer to a query in time."""


def configuration(settings: site_file.TransportSection, hub: bool, access: Access = NOBODY) -> zenoh.Config:
    """Return the zenoh configuration of the hub (the service) or of a client (rig agent, viewer)."""
    config = zenoh.Config()

    def put(key: str, value: Any) -> None:
        config.insert_json5(key, json.dumps(value))

    put("mode", settings.mode if hub else "client")
    put("listen/endpoints", settings.listen if hub else [])
    put("connect/endpoints", settings.connect if hub else settings.endpoints())
    put("scouting/multicast/enabled", False)
    put("scouting/gossip/enabled", False)
    put("transport/shared_memory/enabled", False)
    put("transport/unicast/accept_pending", HALF_OPEN)
    put("connect/retry", {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2})
    if not hub:
        patience = 1000 * settings.patience_seconds if len(settings.endpoints()) == 1 else 0  # of several, zenoh would try the first only
        put("connect/timeout_ms", round(patience))
        put("connect/exit_on_failure", True)
    _secure(put, settings, hub, access)
    return config


def _secure(put: Callable[[str, Any], None], settings: site_file.TransportSection, hub: bool, access: Access) -> None:
    """Mutual TLS with the certificate of the own name; the hub enforces which keys each name may publish."""
    if settings.security is None:
        return
    files = key_files(settings.security, access.identity)
    tls = {"root_ca_certificate": files.authority, "verify_name_on_connect": True, "enable_mtls": True}
    side = "listen" if hub else "connect"
    tls |= {f"{side}_certificate": files.certificate, f"{side}_private_key": files.private_key}
    for key, value in tls.items():
        put(f"transport/link/tls/{key}", str(value) if isinstance(value, Path) else value)
    if hub:
        put("access_control", access.rules)


def _closed(session: zenoh.Session) -> None:
    try:
        session.close()  # type: ignore[no-untyped-call]
    except zenoh.ZError as error:
        log.warning("closing the zenoh session: %s", error)


class Transport:
    """One zenoh session. Use it as a context manager: leaving closes it, whatever happened."""

    def __init__(self, settings: site_file.TransportSection, hub: bool, access: Access = NOBODY) -> None:
        self._settings, self._hub, self._access = settings, hub, access
        self._session: zenoh.Session | None = None
        self._publishers: dict[str, Any] = {}
        self._keep: list[Any] = []
        self._declared: list[Callable[[], Any]] = []
        self._pools: list[ThreadPoolExecutor] = []
        self._heard: dict[str, tuple[float, bool]] = {}
        self._lock, self._closing = threading.Lock(), threading.Event()
        self.lost = 0

    def __enter__(self) -> Transport:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def open(self) -> None:
        """Open the session; raises `NoPeer` when that cannot be done now. Several places to connect to are tried one after the other."""
        several = not self._hub and len(self._settings.endpoints()) > 1
        deadline = time.monotonic() + (self._settings.patience_seconds if several else 0.0)
        while True:
            try:
                self._session = zenoh.open(configuration(self._settings, self._hub, self._access))
                return
            except zenoh.ZError as error:
                if time.monotonic() >= deadline or self._closing.wait(AGAIN_SECONDS):
                    raise NoPeer(self._why_not(str(error))) from error

    def close(self) -> None:
        """Close the session; harmless when called twice. A peer that does not answer delays this by `CLOSING_SECONDS` at most."""
        self._closing.set()
        session, self._session = self._session, None
        if session is None:
            return
        for pool in self._pools:
            pool.shutdown(wait=False, cancel_futures=True)
        closing = threading.Thread(target=_closed, args=(session,), name="closing zenoh", daemon=True)
        closing.start()
        closing.join(CLOSING_SECONDS)

    def reopen(self, access: Access) -> None:
        """Close the session and open one with new certificates and access rules; whatever was declared is declared again.

        Whoever publishes meanwhile waits, for as long as it cannot be opened: a rig's service may be away. What is not open stays so.
        """
        with self._lock:
            session, self._session, self._access = self._session, None, access
            if session is None:
                return
            self._publishers.clear()
            self._keep.clear()
            _closed(session)
            while not self._closing.is_set():
                with suppress(NoPeer):
                    self.open()
                    self._keep += [make() for make in self._declared]
                    return
                self._closing.wait(0.5)

    def _declare(self, make: Callable[[], Any]) -> None:
        self._keep.append(make())
        self._declared.append(make)

    def publish(self, key: str, payload: bytes, keep: bool = True) -> None:
        """Send bytes; late or stalled subscribers get what they missed from the publisher's cache.

        What only its newest value matters of (``keep`` False) is not cached, and never waits for a stalled subscriber: it is
        dropped for that one. Anything else may wait for some seconds, so send it from a thread that can.
        """
        if not keep and self._session is None:
            return  # the session is being opened anew: a lease, say, must not wait for it
        self._publisher(key, keep).put(payload)

    def heard(self, key: str) -> bool:
        """Whether anybody listens to a key whose messages are not kept; asked of zenoh twice a second, so it may be that old."""
        now = time.monotonic()
        until, answer = self._heard.get(key, (0.0, False))
        if now > until:
            if self._session is None:
                return False
            answer = bool(self._publisher(key, False).matching_status.matching)
            self._heard[key] = now + HEARD_SECONDS, answer
        return answer

    def _publisher(self, key: str, keep: bool) -> Any:
        with self._lock:
            publisher = self._publishers.get(key)
            if publisher is None:
                publisher = self._publishers[key] = self._declare_publisher(key, keep)
        return publisher

    def subscribe(self, pattern: str, receive: Receive, missed: bool = True) -> None:
        """Call ``receive(key, payload)`` for everything published on the pattern, in a thread of its own.

        ``missed`` asks publishers for what was said before and what got lost on the way, as far back as they keep it
        (``transport.cache_blocks``); without it only news come.
        """

        reported = float("-inf")

        def hear(sample: zenoh.Sample) -> None:
            nonlocal reported
            try:
                receive(str(sample.key_expr), sample.payload.to_bytes())
            except AfdsvcError as error:  # whoever sends rubbish must not fill the log
                if time.monotonic() - reported > REPORT_SECONDS:
                    reported = time.monotonic()
                    log.warning("a message on %s is ignored, and others like it for %g s: %s", sample.key_expr, REPORT_SECONDS, error)
            except Exception:
                log.exception("a message on %s could not be handled", sample.key_expr)

        if not missed:
            self._declare(lambda: self._open().declare_subscriber(pattern, hear))
            return

        def declare() -> Any:
            subscriber = ext.declare_advanced_subscriber(
                self._open(),
                pattern,
                hear,
                recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
                history=ext.HistoryConfig(detect_late_publishers=True, max_samples=self._settings.cache_blocks),
                subscriber_detection=True,
            )
            return subscriber, subscriber.sample_miss_listener(self._count_miss)

        self._declare(declare)

    def serve(self, key: str, answer: Answer, threads: int = 0) -> None:
        """Answer queries on a key; an exception becomes an error reply with its sentence.

        With ``threads``, so many queries are answered at a time; without, one after the other.
        """

        def reply(query: zenoh.Query) -> None:
            with query:
                try:
                    payload = query.payload.to_bytes() if query.payload is not None else b""
                    query.reply(key, answer(payload))
                except Exception as error:
                    query.reply_err(str(error).encode())

        if not threads:
            self._declare(lambda: self._open().declare_queryable(key, reply))
            return
        pool = ThreadPoolExecutor(threads, f"answers at {key}")
        self._pools.append(pool)
        self._declare(lambda: self._open().declare_queryable(key, lambda query: pool.submit(reply, query)))

    def ask(self, key: str, payload: bytes, timeout: float = 5.0) -> bytes:
        """Send a query and return the first reply; raises `PeerSilent` or `AfdsvcError` with the peer's own words."""
        for reply in self._open().get(key, payload=payload, timeout=timeout):
            if reply.ok is not None:
                return bytes(reply.ok.payload.to_bytes())
            words = reply.err.payload.to_string() if reply.err is not None else "no reason given"
            if words == "Timeout":
                raise PeerSilent(f"no answer from {key} within {timeout:g} s")
            raise AfdsvcError(words)
        raise PeerSilent(self._why_silent(key))

    def announce(self, key: str) -> None:
        """Show that this process is alive, until the session closes or the process dies."""
        self._declare(lambda: self._open().liveliness().declare_token(key))

    def watch(self, pattern: str, changed: Callable[[str, bool], None]) -> None:
        """Call ``changed(key, alive)`` whenever a token appears or goes, first for those that are there."""

        def hear(sample: zenoh.Sample) -> None:
            changed(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        self._declare(lambda: self._open().liveliness().declare_subscriber(pattern, hear, history=True))

    def alive(self, pattern: str) -> list[str]:
        """Return the keys of the live tokens that match."""
        return [str(r.ok.key_expr) for r in self._open().liveliness().get(pattern, timeout=2.0) if r.ok is not None]

    def _declare_publisher(self, key: str, keep: bool) -> Any:
        if not keep:
            return self._open().declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP)
        return ext.declare_advanced_publisher(
            self._open(),
            key,
            congestion_control=zenoh.CongestionControl.BLOCK,
            cache=ext.CacheConfig(max_samples=self._settings.cache_blocks),
            sample_miss_detection=ext.MissDetectionConfig(heartbeat=0.2, sporadic_heartbeat=None),
            publisher_detection=True,
        )

    def _count_miss(self, miss: Any) -> None:
        self.lost += miss.nb

    def _open(self) -> zenoh.Session:
        if self._session is None:
            raise AfdsvcError("the zenoh session is closed")
        return self._session

    def _why_silent(self, key: str) -> str:
        if self._settings.security is None:
            return f"no answer at {key}; it does not run, or is still being prepared"
        who = self._access.identity
        return f"no answer at {key}: it does not run, or '{who}' lacks permission for this request at this secured site"

    def _why_not(self, error: str) -> str:
        error = error.partition(" at /")[0]  # where in zenoh's own source
        where = ", ".join(self._settings.listen if self._hub else self._settings.endpoints())
        if self._hub:
            return f"zenoh cannot listen at {where} ({error}); is another service running there?"
        return f"no service answers at {where}; start it with 'afdsvc serve' ({error})"
