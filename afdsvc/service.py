"""The background service of one site, a rig agent, and diagnosis offline: the only place that joins concrete parts."""

from __future__ import annotations

import itertools
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import numpy as np

from afdsvc import __version__, commission
from afdsvc.api.bursts import Burst
from afdsvc.api.clock import Clock
from afdsvc.api.detection import DetectionProblem, FalseAlarms
from afdsvc.commission import Commissioned
from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.excite import default_burst
from afdsvc.plugins.manager import Plugins, load
from afdsvc.review.sink import ReviewSink
from afdsvc.runtime.agent import RigAgent
from afdsvc.runtime.clock import RealClock
from afdsvc.runtime.desk import BurstDesk
from afdsvc.runtime.hub import Hub
from afdsvc.runtime.pipeline import CalibratedPipeline, Pipeline, Stream
from afdsvc.runtime.publishing import Publisher
from afdsvc.runtime.recording import RecorderSink
from afdsvc.runtime.scheduler import Scheduler, Wanted
from afdsvc.runtime.sinks import Fan, Sink, ThreadedSink
from afdsvc.runtime.site import Site
from afdsvc.runtime.transport import Transport
from afdsvc.runtime.watch import MachineWatch
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import RigDescription


def pipeline_of(machine: Commissioned, plugins: Plugins) -> Stream:
    """Return the machine's way from blocks to evidence, calibrated on its first quiet data where the site wants that."""

    def design(output_cov: np.ndarray, process_cov: np.ndarray | None, frozen_after: int) -> Pipeline:
        base = commission.problem(machine, output_cov, process_cov, FalseAlarms())
        return Pipeline(base, commission.detectors(machine, base, plugins), commission.expectation(machine, frozen_after))

    seconds = machine.config.calibrate_seconds
    if seconds:
        return CalibratedPipeline(machine.plant, commission.expectation(machine, 0), round(seconds / machine.plant.dt), design)
    if machine.output_cov is None:
        raise BadInput(f"machine '{machine.config.id}': the noise is unknown; set 'output_sd' or 'calibrate_seconds'")
    return design(machine.output_cov, machine.process_cov, 50)


@contextmanager
def serving(site: Site, clock: Clock | None = None) -> Iterator[Hub]:
    """Run the service of a site while the block lasts."""
    clock, plugins = clock or RealClock(), load()
    machines = [commission.commission(m, plugins) for m in site.machines]
    keys = Keys(site.site)
    with ExitStack() as stack:
        transport = stack.enter_context(Transport(site.transport, hub=True))
        recorders: list[tuple[RecorderSink, ThreadedSink]] = []
        watches, desks = {}, {}
        for number, machine in enumerate(machines):
            stream = pipeline_of(machine, plugins)
            sink = _sinks(site, machine, keys, transport, clock, recorders)
            stack.callback(sink.close)
            id = machine.config.id
            watches[id] = MachineWatch(id, stream, sink, clock)
            if machine.limits is not None and isinstance(stream, Pipeline):
                desks[id] = _desk(machine, stream, sink, keys, transport, clock, number)
        hub = Hub(keys, __version__, watches, desks, transport, clock, lambda: _recording(recorders))
        hub.start()
        stack.callback(hub.stop)
        yield hub


def _sinks(
    site: Site, machine: Commissioned, keys: Keys, transport: Transport, clock: Clock,
    recorders: list[tuple[RecorderSink, ThreadedSink]],
) -> Fan:
    recorder = RecorderSink(site, machine.config.id, machine.about(), clock)
    recording = ThreadedSink(recorder, "afdsvc-recorder", lambda why: print(f"recording: {why}", flush=True))
    recorders.append((recorder, recording))
    sinks: list[Sink] = [recording, Publisher(keys, transport)]
    if site.review.rerun != "off":
        review = ReviewSink(site, machine.config.id, recorder.path_for("rrd"))
        sinks.append(ThreadedSink(review, "afdsvc-review", lambda why: print(f"review: {why}", flush=True)))
    return Fan(sinks)


def _recording(recorders: list[tuple[RecorderSink, ThreadedSink]]) -> tuple[str, int, str, int]:
    files = ", ".join(str(r.path) for r, _ in recorders if r.path)
    size = sum(r.bytes_written for r, _ in recorders)
    failure = next((t.failure for _, t in recorders if t.failure), "")
    return files, size, failure, sum(t.dropped for _, t in recorders)


def _desk(
    machine: Commissioned, stream: Pipeline, sink: Sink, keys: Keys, transport: Transport, clock: Clock, number: int
) -> BurstDesk:
    rng = np.random.default_rng(number)
    scheduler = Scheduler(machine.config.bursts, rng, clock.monotonic())
    return BurstDesk(machine.config.id, burst_design(machine, stream.problem), scheduler, stream, sink, keys, transport, clock)


def burst_design(machine: Commissioned, problem: DetectionProblem) -> Callable[[Wanted], Burst]:
    """Return the design of the machine's bursts; the diagnosis burst is computed once."""
    settings = machine.config.bursts
    if machine.limits is None:
        raise BadInput(f"machine '{machine.config.id}' can be watched, not excited")
    burst = default_burst(problem, machine.limits, seconds=settings.seconds, output_amplitude=settings.output_amplitude)
    return lambda wanted: burst


def rig_agent(site: Site, id: str, transport: Transport, clock: Clock | None = None) -> RigAgent:
    """Return the rig agent of one machine, its port open, ready to run."""
    clock, plugins = clock or RealClock(), load()
    machine = commission.commission(site.machine(id), plugins)
    session = uuid.uuid4().hex
    port = commission.open_port(machine, session, clock, plugins)
    description = RigDescription(
        id, session, clock.now_ns(), port.dt, port.channels, machine.limits,
        machine.controller.description if machine.controller else "", site.text, machine.model_text(), __version__,
        machine.config.driver.kind,
    )
    return RigAgent(Keys(site.site), description, port, transport, clock)
