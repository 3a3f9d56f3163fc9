"""`afdsvc rig`: the rig agent of one machine; control starts first and does not depend on the network."""

from __future__ import annotations

import logging
import sys
import threading
import uuid
from contextlib import ExitStack, closing
from functools import partial

from afdsvc import __version__
from afdsvc.api.clock import Clock
from afdsvc.app import commissioning, ports
from afdsvc.files.site import Site
from afdsvc.hal.agent import RigAgent
from afdsvc.hal.store import Store
from afdsvc.plugins.manager import load
from afdsvc.service.clock import RealClock
from afdsvc.transport.access_rules import KeyWatch, access_of
from afdsvc.transport.certificates import rig_name
from afdsvc.transport.zenoh_session import NoPeer, Transport
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import RigDescription

log = logging.getLogger(__name__)


def rig_agent(site: Site, id: str, transport: Transport, clock: Clock) -> RigAgent:
    """Return the rig agent of one machine, its port open, ready to run."""
    plugins = load()
    machine = commissioning.commission(site.machine(id), plugins, allow_code=True)
    session, real_time = uuid.uuid4().hex, machine.config.driver.real_time
    store = _store(site, id, clock) if real_time else None
    with ExitStack() as undone:
        undone.callback(store.close if store else lambda: None)
        port = ports.open_port(machine, session, clock, plugins)
        undone.pop_all()
    description = RigDescription(
        id, session, clock.now_ns(), port.dt, port.channels, machine.limits,
        machine.controller.description if machine.controller else "unknown", site.text, machine.model_text(), __version__,
        machine.config.driver.kind,
    )  # fmt: skip
    truth = [(round(f.at_seconds / port.dt), f"{f.name} {f.severity:g}") for f in machine.config.driver.faults]
    return RigAgent(Keys(site.site), description, port, transport, clock, truth, patient=not real_time, store=store)


def _store(site: Site, id: str, clock: Clock) -> Store | None:
    """Return where blocks are kept that the service does not acknowledge, None where the site names no folder; refuses a second agent."""
    if site.transport.store is None:
        return None
    store = Store(site.transport.store, id, 1e6 * site.transport.store_megabytes, clock)
    store.claim()
    return store


def run_rig(
    site: Site, id: str, seconds: float | None, stop: threading.Event, emergency: threading.Event | None = None
) -> None:
    """Run a rig agent. Control begins at once and the network joins when a service is there; a replay waits for it instead."""
    config, clock = site.machine(id), RealClock()
    commissioning.commission(config, load(), allow_code=True)
    settings = site.transport.model_copy(update={"patience_seconds": min(site.transport.patience_seconds, 1.0)})
    transport = Transport(settings, False, access_of(site, rig_name(id)))
    connect = partial(_wait_for_service, transport)
    waits = not config.driver.real_time or config.driver.kind == "replay"
    with closing(transport):
        if waits:
            connect(stop)
        if stop.is_set():
            return
        agent = rig_agent(site, id, transport, clock)
        agent.stopping, agent.emergency = stop, emergency or threading.Event()
        agent.connect = None if waits else connect
        with ExitStack() as stack:
            if site.transport.security is not None:
                keys = KeyWatch(site, rig_name(id), transport.reopen, clock, lambda: agent.playing, log.info)
                stack.callback(keys.close)
            agent.run(seconds)


def _wait_for_service(transport: Transport, stop: threading.Event) -> None:
    """Open the transport as soon as a service is there; say once that it is not."""
    reported = False
    while not stop.is_set():
        try:
            transport.open()
            return
        except NoPeer as absent:
            if not reported:
                print(f"afdsvc: waiting: {absent}", file=sys.stderr, flush=True)
            reported = True
            stop.wait(0.2)
