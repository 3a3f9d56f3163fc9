"""The background service of one site and the rig agent: the only place that joins concrete parts."""

from __future__ import annotations

import sys
import threading
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from functools import lru_cache, partial
from typing import Any

import numpy as np

from afdsvc import __version__, commission
from afdsvc.api.bursts import Burst
from afdsvc.api.clock import Clock
from afdsvc.api.detection import DetectionProblem, FalseAlarms
from afdsvc.commission import Commissioned
from afdsvc.diagnosis.alarm_book import Policy
from afdsvc.diagnosis.pipeline import CalibratedPipeline, Judged, Pipeline, calibrated
from afdsvc.diagnosis.speed_schedule import SpeedPipeline
from afdsvc.errors import BadInput
from afdsvc.excite.diagnosis_burst import Aim, default_burst, second_burst
from afdsvc.files.site import Site
from afdsvc.hal.agent import RigAgent
from afdsvc.outlets import Outlets, open_outboxes
from afdsvc.plugins.manager import Plugins, load
from afdsvc.service import operator_requests
from afdsvc.service.burst_requests import BurstDesk
from afdsvc.service.clock import RealClock
from afdsvc.service.hub import Hub
from afdsvc.service.machine import MachineWatch
from afdsvc.service.metrics import serve_metrics
from afdsvc.service.operator_requests import QUESTIONS
from afdsvc.service.scheduler import Scheduler, Wanted
from afdsvc.service.sinks.fan_out import Fan
from afdsvc.service.sinks.publisher_sink import Publisher
from afdsvc.service.status_page import serve_page
from afdsvc.service.warm_up import Rehearsals
from afdsvc.transport.access_rules import SERVICE, access_control, rig_name
from afdsvc.transport.outgoing_queue import Post
from afdsvc.transport.zenoh_session import Access, NoPeer, Transport
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import RigDescription


def pipeline_of(
    machine: Commissioned, plugins: Plugins, ready: Callable[[DetectionProblem], object] | None = None, beside: Executor | None = None
) -> Judged:
    """Return the machine's way from blocks to evidence, calibrated on its first quiet data where the site wants that.

    A machine with ``speed_step_rpm`` has one way for every speed; ``ready`` is called with the problem of each, and those of
    later speeds are made by ``beside`` when that is given.
    """
    if machine.config.speed_step_rpm:
        made = _speed_pipeline(machine, plugins, ready)
        made.later = beside.submit if beside else None
        return made
    design = _design(machine, plugins)
    samples = round(machine.config.calibrate_seconds / machine.plant.dt)
    if machine.config.calibrate_on:
        return calibrated(machine.plant, *commission.quiet_samples(machine, samples), design)[0]
    if samples:
        return CalibratedPipeline(machine.plant, commission.expectation(machine, 0), samples, design)
    return design(*_stated_noise(machine), 50)


def _stated_noise(machine: Commissioned) -> tuple[np.ndarray, np.ndarray | None]:
    if machine.output_cov is None:
        raise BadInput(f"machine '{machine.config.id}': the noise is unknown; set 'output_sd' or 'calibrate_seconds'")
    return machine.output_cov, machine.process_cov


def _design(machine: Commissioned, plugins: Plugins) -> Callable[[np.ndarray, np.ndarray | None, int], Pipeline]:
    def design(output_cov: np.ndarray, process_cov: np.ndarray | None, frozen_after: int) -> Pipeline:
        base = commission.problem(machine, output_cov, process_cov, FalseAlarms())
        return Pipeline(base, commission.detectors(machine, base, plugins), commission.expectation(machine, frozen_after))

    return design


def _speed_pipeline(machine: Commissioned, plugins: Plugins, ready: Callable[[DetectionProblem], object] | None) -> SpeedPipeline:
    """Return the pipeline of a machine whose speed changes; what was designed for a speed is kept."""
    if "aux_speed" not in {c.name for c in machine.channels}:
        raise BadInput(f"machine '{machine.config.id}' does not turn; 'speed_step_rpm' is for one that records aux_speed")
    noise, kept = _stated_noise(machine), dict[float, Pipeline]()

    def design(speed: float) -> Pipeline:
        if speed not in kept:
            kept[speed] = _design(commission.at_speed(machine, speed), plugins)(*noise, 50)
            if ready:
                ready(kept[speed].problem)
        made = kept[speed]
        return Pipeline(made.problem, made.detectors, made.expected)

    return SpeedPipeline(design, (machine.config.speed_step_rpm or 0.0) * np.pi / 30, machine.speed)


@contextmanager
def serving(site: Site, clock: Clock | None = None) -> Iterator[Hub]:
    """Run the service of a site while the block lasts; raises `BadInput` before anything moves when the site is wrong."""
    clock, plugins = clock or RealClock(), load()
    machines = [commission.commission(m, plugins) for m in site.machines]
    keys, outlets = Keys(site.site), Outlets(site, clock)
    with ExitStack() as stack:
        transport = stack.enter_context(Transport(site.transport, True, access_of(site, SERVICE)))
        post, news = Post(transport.publish, "post"), Post(partial(transport.publish, keep=False), "news", size=400)
        outlets.posts.append(post)
        for opened in (post, news):
            stack.callback(opened.close, 0.5)
        stack.callback(outlets.close)
        beside = ThreadPoolExecutor(1, "afdsvc-commission")
        stack.callback(beside.shutdown, wait=False, cancel_futures=True)
        watches: dict[str, MachineWatch] = {}
        desks: dict[str, BurstDesk] = {}
        rehearsed: list[tuple[Pipeline, Burst]] = []
        for machine in machines:
            id, diagnosis = machine.config.id, diagnosis_burst(machine)
            stream = pipeline_of(machine, plugins, diagnosis, beside)
            sink = Fan([*outlets.of(machine), Publisher(keys, post, news, transport.heard)])
            watches[id] = MachineWatch(id, stream, sink, clock)
            if machine.limits is not None and isinstance(stream, Pipeline):
                rehearsed.append((stream, diagnosis(stream.problem)))
            if machine.limits is not None:
                scheduler = Scheduler(machine.config.bursts, np.random.default_rng(len(desks)), 0.0)
                desks[id] = BurstDesk(id, burst_design(machine, stream, diagnosis), scheduler, stream, sink, keys, transport, clock)
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
        housekeeper = outlets.housekeeper()
        rehearsals = Rehearsals(rehearsed)
        rehearsals.start()
        stack.callback(rehearsals.close)
        hub.start()
        stack.callback(hub.stop)
        housekeeper.start()
        stack.callback(housekeeper.close)
        if site.metrics.listen:
            stack.callback(serve_metrics(site.metrics.listen, hub.status))
        if site.web.listen:
            stack.callback(serve_page(site.web.listen, hub))
        yield hub


def diagnosis_burst(machine: Commissioned) -> Callable[[DetectionProblem], Burst]:
    """Return the design of the machine's diagnosis burst, computed once for every problem."""

    @lru_cache(maxsize=64)
    def design(problem: DetectionProblem) -> Burst:
        settings, limits = machine.config.bursts, machine.limits
        if limits is None:
            raise BadInput(f"machine '{machine.config.id}' can be watched, not excited")
        return default_burst(problem, limits, settings.seconds, settings.output_amplitude, Aim(severity=settings.severity))

    return design


def burst_design(
    machine: Commissioned, stream: Judged, diagnosis: Callable[[DetectionProblem], Burst] | None = None
) -> Callable[[Wanted], Burst]:
    """Return the design of the machine's bursts by purpose, for the speed the machine runs at."""
    settings, limits = machine.config.bursts, machine.limits
    if limits is None:
        raise BadInput(f"machine '{machine.config.id}' can be watched, not excited")
    diagnosis = diagnosis or diagnosis_burst(machine)
    if not isinstance(stream, CalibratedPipeline) or stream.pipeline:
        diagnosis(stream.problem)  # what is wrong with it shows before anything moves
    rng = np.random.default_rng(0)

    def design(wanted: Wanted) -> Burst:
        problem = stream.problem
        if wanted.purpose == "diagnose":
            return diagnosis(problem)
        if wanted.question:
            return second_burst(problem, limits, wanted.question.weights, wanted.question.severity, settings.seconds)
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
    return RigAgent(Keys(site.site), description, port, transport, clock, truth, patient=not machine.config.driver.real_time)


def run_rig(
    site: Site, id: str, seconds: float | None, stop: threading.Event, emergency: threading.Event | None = None
) -> None:
    """Run a rig agent. Control begins at once and the network joins when a service is there; a replay waits for it instead."""
    config, clock = site.machine(id), RealClock()
    commission.commission(config, load())
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
        agent.run(seconds)


def _wait_for_service(transport: Transport, stop: threading.Event) -> None:
    """Open the transport as soon as a service is there; say once that it is not."""
    told = False
    while not stop.is_set():
        try:
            transport.open()
            return
        except NoPeer as absent:
            if not told:
                print(f"afdsvc: waiting: {absent}", file=sys.stderr, flush=True)
            told = True
            stop.wait(0.2)


def ask_service(site: Site, name: str, asked_by: str, **arguments: Any) -> Any:
    """Ask the running service of a site; returns JSON values, raises the service's own sentence.

    On a secured site ``asked_by`` is the name in the certificate that is shown.
    """
    with Transport(site.transport, False, access_of(site, asked_by)) as transport:
        keys = Keys(site.site)
        key = keys.question() if name in QUESTIONS else keys.command()
        return operator_requests.ask(lambda payload: transport.ask(key, payload), name, asked_by, **arguments)


def access_of(site: Site, identity: str) -> Access:
    """Return who a process of the site is, and the rules by which its service lets others speak."""
    security = site.transport.security
    if security is None:
        return Access(identity)
    machines = [m.id for m in site.machines]
    return Access(identity, access_control(Keys(site.site), machines, security.operators, security.viewers))
