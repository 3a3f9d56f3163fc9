"""The background service of one site and the rig agent: the only place that joins concrete parts."""

from __future__ import annotations

import sys
import threading
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np

from afdsvc import __version__, commission
from afdsvc.alarms.book import Policy
from afdsvc.api.bursts import Burst
from afdsvc.api.clock import Clock
from afdsvc.api.detection import FalseAlarms
from afdsvc.commission import Commissioned
from afdsvc.errors import BadInput
from afdsvc.excite.default import default_burst, second_burst
from afdsvc.outlets import Outlets, open_outboxes
from afdsvc.plugins.manager import Plugins, load
from afdsvc.runtime import commands
from afdsvc.runtime.agent import RigAgent
from afdsvc.runtime.clock import RealClock
from afdsvc.runtime.desk import BurstDesk
from afdsvc.runtime.hub import Hub
from afdsvc.runtime.metrics import serve_metrics
from afdsvc.runtime.pipeline import CalibratedPipeline, Pipeline, Stream, calibrated
from afdsvc.runtime.publishing import Publisher
from afdsvc.runtime.scheduler import Scheduler, Wanted
from afdsvc.runtime.sinks import Fan
from afdsvc.runtime.site import Site
from afdsvc.runtime.transport import NoPeer, Transport
from afdsvc.runtime.watch import MachineWatch
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import RigDescription


def pipeline_of(machine: Commissioned, plugins: Plugins) -> Stream:
    """Return the machine's way from blocks to evidence, calibrated on its first quiet data where the site wants that."""

    def design(output_cov: np.ndarray, process_cov: np.ndarray | None, frozen_after: int) -> Pipeline:
        base = commission.problem(machine, output_cov, process_cov, FalseAlarms())
        return Pipeline(base, commission.detectors(machine, base, plugins), commission.expectation(machine, frozen_after))

    samples = round(machine.config.calibrate_seconds / machine.plant.dt)
    if machine.config.calibrate_on:
        return calibrated(machine.plant, *commission.quiet_samples(machine, samples), design)[0]
    if samples:
        return CalibratedPipeline(machine.plant, commission.expectation(machine, 0), samples, design)
    if machine.output_cov is None:
        raise BadInput(f"machine '{machine.config.id}': the noise is unknown; set 'output_sd' or 'calibrate_seconds'")
    return design(machine.output_cov, machine.process_cov, 50)


@contextmanager
def serving(site: Site, clock: Clock | None = None) -> Iterator[Hub]:
    """Run the service of a site while the block lasts; raises `BadInput` before anything moves when the site is wrong."""
    clock, plugins = clock or RealClock(), load()
    machines = [commission.commission(m, plugins) for m in site.machines]
    keys, outlets = Keys(site.site), Outlets(site, clock)
    with ExitStack() as stack:
        transport = stack.enter_context(Transport(site.transport, hub=True))
        stack.callback(outlets.close)
        watches: dict[str, MachineWatch] = {}
        desks: dict[str, BurstDesk] = {}
        for machine in machines:
            id, stream = machine.config.id, pipeline_of(machine, plugins)
            sink = Fan([*outlets.of(machine), Publisher(keys, transport)])
            watches[id] = MachineWatch(id, stream, sink, clock)
            if machine.limits is not None and isinstance(stream, Pipeline):
                scheduler = Scheduler(machine.config.bursts, np.random.default_rng(len(desks)), 0.0)
                desks[id] = BurstDesk(id, burst_design(machine, stream), scheduler, stream, sink, keys, transport, clock)
        history = outlets.history()
        outboxes = open_outboxes(site, history, plugins)
        for outbox in outboxes:
            stack.callback(outbox.close)
        a = site.alarms
        policy = Policy(a.raise_after, a.clear_after, a.latch, a.shelve_minutes)
        hub = Hub(
            keys, __version__, watches, desks, transport, clock, outlets.summary, outlets.files, policy=policy, history=history,
            outboxes=outboxes,
        )  # fmt: skip
        hub.start()
        stack.callback(hub.stop)
        if site.metrics.listen:
            stack.callback(serve_metrics(site.metrics.listen, hub.status))
        yield hub


def burst_design(machine: Commissioned, stream: Pipeline) -> Callable[[Wanted], Burst]:
    """Return the design of the machine's bursts by purpose; the diagnosis burst is computed once."""
    settings, limits = machine.config.bursts, machine.limits
    if limits is None:
        raise BadInput(f"machine '{machine.config.id}' can be watched, not excited")
    burst = default_burst(stream.problem, limits, seconds=settings.seconds, output_amplitude=settings.output_amplitude)
    rng = np.random.default_rng(0)

    def design(wanted: Wanted) -> Burst:
        if wanted.purpose == "diagnose":
            return burst
        if wanted.question:
            return second_burst(stream.problem, limits, wanted.question.weights, wanted.question.severity, settings.seconds)
        return commission.identification_burst(machine, wanted.purpose, rng)

    return design


def rig_agent(site: Site, id: str, transport: Transport, clock: Clock) -> RigAgent:
    """Return the rig agent of one machine, its port open, ready to run."""
    plugins = load()
    machine = commission.commission(site.machine(id), plugins)
    session = uuid.uuid4().hex
    port = commission.open_port(machine, session, clock, plugins)
    description = RigDescription(
        id, session, clock.now_ns(), port.dt, port.channels, machine.limits,
        machine.controller.description if machine.controller else "unknown", site.text, machine.model_text(), __version__,
        machine.config.driver.kind,
    )  # fmt: skip
    truth = [(round(f.at_seconds / port.dt), f"{f.name} {f.severity:g}") for f in machine.config.driver.faults]
    return RigAgent(Keys(site.site), description, port, transport, clock, truth)


def run_rig(site: Site, id: str, seconds: float | None, stop: threading.Event) -> None:
    """Run a rig agent; while no service is there yet, it waits for one."""
    commission.commission(site.machine(id), load())
    clock, told = RealClock(), False
    while not stop.is_set():
        try:
            with Transport(site.transport, hub=False) as transport:
                agent = rig_agent(site, id, transport, clock)
                agent.stopping = stop
                return agent.run(seconds)
        except NoPeer as absent:
            if not told:
                print(f"afdsvc: waiting: {absent}", file=sys.stderr, flush=True)
            told = True


def ask_service(site: Site, name: str, asked_by: str, **arguments: Any) -> Any:
    """Ask the running service of a site; returns JSON values, raises the service's own sentence."""
    with Transport(site.transport, hub=False) as transport:
        key = Keys(site.site).command()
        return commands.ask(lambda payload: transport.ask(key, payload), name, asked_by, **arguments)
