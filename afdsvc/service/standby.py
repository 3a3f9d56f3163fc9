"""Hot standby: the second of two services of a site keeps the alarms of the first and takes its turn when the first is gone.

Both read the same site file; the first listens at ``transport.listen``, the second at ``transport.standby``, and rigs know both places. Each rig is
connected to one service and obeys no other. Whichever starts and finds the other one serving stands by.
"""

from __future__ import annotations

import base64
import json
import logging
import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from afdsvc.errors import AfdsvcError
from afdsvc.files.site import TransportSection
from afdsvc.service.notifications import History
from afdsvc.transport.access_rules import Access
from afdsvc.transport.zenoh_session import NoPeer, Transport
from afdsvc.wire import codec
from afdsvc.wire.keys import SERVICE, Keys
from afdsvc.wire.messages import AlarmChange

log = logging.getLogger(__name__)
LOOK_SECONDS = 0.2
YIELD_SECONDS = 5.0
PATIENCE_SECONDS = 1.0  # for a connection to the other service


@dataclass(frozen=True, slots=True)
class Standby:
    """One of two services: ``other`` says how to reach the other one, ``grace`` [s] how long it may take to appear at the first start."""

    other: TransportSection
    keys: Keys
    history: History
    grace: float

    def wait(self, stopping: threading.Event, beat: Callable[[], object]) -> None:
        """Return when no other service serves this site (or ``stopping`` is set); until then keep its alarms. ``beat`` is called all the time."""
        deadline, served = time.monotonic() + self.grace, False
        while not stopping.is_set() and not served:
            beat()
            with suppress(NoPeer), self._session() as session:
                served = self._follow(session, stopping, beat)
            if not served and time.monotonic() >= deadline:
                return
            stopping.wait(0 if served else LOOK_SECONDS)

    def hold(self, stopping: threading.Event, seconds: float | None, idle: Callable[[], bool]) -> None:
        """Return when ``stopping`` is set, the seconds have passed, or the other service serves too and no machine is connected here (``idle()``).

        Both serve after the network between them was cut; the one that ends is started again by its supervisor and stands by.
        """
        deadline = float("inf") if seconds is None else time.monotonic() + seconds
        while not stopping.wait(min(YIELD_SECONDS, max(deadline - time.monotonic(), 0.0))) and time.monotonic() < deadline:
            if idle() and self._other_serves():
                log.warning("the other service of site '%s' serves too, and no machine is connected here: this one ends", self.keys.site)
                return

    def _other_serves(self) -> bool:
        try:
            with self._session() as session:
                return bool(session.alive(self.keys.service_alive()))
        except NoPeer:
            return False

    def _session(self) -> Transport:
        return Transport(self.other.model_copy(update={"patience_seconds": PATIENCE_SECONDS}), False, Access(SERVICE))

    def _follow(self, session: Transport, stopping: threading.Event, beat: Callable[[], object]) -> bool:
        """Keep the alarms of the other service until it is gone; return whether it was there."""
        if not session.alive(self.keys.service_alive()):
            return False
        gone, news = threading.Event(), queue.SimpleQueue[bytes]()
        session.watch(self.keys.service_alive(), lambda _, alive: None if alive else gone.set())
        session.subscribe(self.keys.alarms(), lambda _, payload: news.put(payload), missed=False)
        log.info("another service of site '%s' runs; this one stands by", self.keys.site)
        self._keep(session)
        while not stopping.is_set():
            over = gone.is_set()
            with suppress(queue.Empty):
                self.history.merge([codec.decode(AlarmChange, news.get(timeout=0 if over else LOOK_SECONDS))])
                continue
            if over:
                log.warning("the other service of site '%s' is gone; this one takes over", self.keys.site)
                return True
            beat()
        return True

    def _keep(self, session: Transport) -> None:
        try:
            self.history.merge(taken_over(session.ask(self.keys.handover(), b"")))
        except AfdsvcError as error:
            log.error("the alarms of the other service cannot be kept: %s", error)


def handed_over(history: History, _question: bytes = b"") -> bytes:
    """Return the message with which a service hands its alarms to the other, the answer to its question."""
    return json.dumps([base64.b64encode(codec.encode(change)).decode() for change in history.handover()]).encode()


def taken_over(message: bytes) -> list[AlarmChange]:
    """Return the changes of alarms, oldest first, that a message of `handed_over` holds."""
    return [codec.decode(AlarmChange, base64.b64decode(text)) for text in json.loads(message)]
