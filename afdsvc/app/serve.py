"""`afdsvc serve`: the background service of one site, and where its recordings, reviews and alarms go."""

from __future__ import annotations

import errno
import hashlib
import logging
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from afdsvc import __version__
from afdsvc.api.bursts import Burst
from afdsvc.api.clock import Clock
from afdsvc.api.notify import Notify
from afdsvc.app import commissioning
from afdsvc.app.commissioning import Commissioned
from afdsvc.app.pipelines import burst_design, diagnosis_burst, pipeline_of, tuning_design
from afdsvc.diagnosis.alarm_book import Policy
from afdsvc.diagnosis.pipeline import Pipeline
from afdsvc.errors import BadInput
from afdsvc.files.site import Site
from afdsvc.plugins.manager import Plugins, load
from afdsvc.service.audit_log import AuditLog
from afdsvc.service.burst_requests import BurstRequests
from afdsvc.service.clock import RealClock
from afdsvc.service.console import SignIn, serve_console
from afdsvc.service.housekeeping import Housekeeper, Keep
from afdsvc.service.hub import Hub
from afdsvc.service.machine import MachineMonitor
from afdsvc.service.metrics import serve_metrics
from afdsvc.service.notifications import History, NotificationQueue
from afdsvc.service.operator_requests import Requests, json_values
from afdsvc.service.recorder_sink import LateRecorder, PreAlarmBuffer, Receipts, RecorderSink
from afdsvc.service.retuning import Retuning
from afdsvc.service.scheduler import Scheduler
from afdsvc.service.sinks import FanOut, LogSink, Publisher, Sink, ThreadedSink
from afdsvc.service.standby import Standby
from afdsvc.service.warm_up import WarmUp
from afdsvc.transport.access_rules import Access, KeyWatch, access_of
from afdsvc.transport.lease_keeper import LeaseKeeper
from afdsvc.transport.outgoing_queue import OutgoingQueue
from afdsvc.transport.zenoh_session import Transport, configuration
from afdsvc.wire.keys import SERVICE, Keys
from afdsvc.wire.messages import AlarmChange

if TYPE_CHECKING:
    from afdsvc.present.rerun.log import ReviewSink

log = logging.getLogger(__name__)
GRACE_SECONDS = 15.0  # in which the first of two services may start
CLOSING_SECONDS = 1.5  # all files together: a service has 5 s to stop


@contextmanager
def serving(site: Site, clock: Clock | None = None, turn: Callable[[History], object] = lambda history: None) -> Iterator[Hub]:
    """Run the service of a site while the block lasts; raises `BadInput` before anything moves when the site is wrong.

    ``turn(history)`` returns when this service may begin (see `afdsvc.service.standby`); what takes long is done before.
    """
    clock, plugins = clock or RealClock(), load()
    machines = [commissioning.commission(m, plugins, allow_code=True) for m in site.machines]
    _refuse_unkept(site)
    keys, sinks = Keys(site.site), SiteSinks(site, clock)
    turn(history := sinks.history())
    with ExitStack() as stack:
        transport = stack.enter_context(Transport(site.transport, True, access_of(site, SERVICE)))
        keeper = LeaseKeeper(str(configuration(site.transport, False, Access(SERVICE))))
        stack.callback(keeper.close)
        post, news = OutgoingQueue(transport.publish, "post"), OutgoingQueue(partial(transport.publish, keep=False), "news", size=400)
        sinks.posts.append(post)
        for opened in (post, news):
            stack.callback(opened.close, 0.5)
        stack.callback(sinks.close)
        beside = ThreadPoolExecutor(1, "afdsvc-commission")
        stack.callback(beside.shutdown, wait=False, cancel_futures=True)
        watches: dict[str, MachineMonitor] = {}
        burst_requests: dict[str, BurstRequests] = {}
        retunings: dict[str, Retuning] = {}
        rehearsed: list[tuple[Pipeline, Burst]] = []
        for machine in machines:
            id, diagnosis = machine.config.id, diagnosis_burst(machine)
            stream = pipeline_of(machine, plugins, diagnosis, beside)
            sink = FanOut([*sinks.of(machine), LogSink(id), Publisher(keys, post, news, transport.heard)])
            watches[id] = MachineMonitor(id, stream, sink, clock)
            if machine.limits is not None and isinstance(stream, Pipeline):
                rehearsed.append((stream, diagnosis(stream.problem)))
            if machine.limits is not None:
                scheduler = Scheduler(machine.config.bursts, np.random.default_rng(len(burst_requests)), 0.0)
                design = burst_design(machine, stream, diagnosis)
                burst_requests[id] = BurstRequests(id, design, scheduler, stream, sink, keys, transport, clock, machine.channels)
                retunings[id] = Retuning(burst_requests[id], tuning_design(machine, plugins), diagnosis)
        outboxes = open_outboxes(site, history, plugins)
        for outbox in outboxes:
            stack.callback(outbox.close)
        policy = Policy(site.alarms.raise_after, site.alarms.clear_after, site.alarms.latch, site.alarms.shelve_minutes)
        hub = Hub(
            keys, __version__, watches, burst_requests, transport, clock, sinks.summary, sinks.files, policy=policy, history=history,
            outboxes=outboxes, audit=stack.enter_context(_audited(site, clock)), late=sinks.late,
            retunings=retunings, keeper=keeper,
        )  # fmt: skip
        housekeeper = sinks.housekeeper()
        rehearsals = WarmUp(rehearsed)
        rehearsals.start()
        stack.callback(rehearsals.close)
        hub.start()
        requests, sign_in = _answering(site, hub, transport, clock, stack)
        stack.callback(hub.stop)
        housekeeper.start()
        stack.callback(housekeeper.close)
        if site.metrics.listen:
            stack.callback(serve_metrics(site.metrics.listen, hub.status))
        if site.web.listen:
            stack.callback(serve_console(site.web.listen, hub, requests, sign_in, site.recording.folder, site.alarms.severity_limit))
            log.info("the operators' console is at http://%s", site.web.listen)
        yield hub


def _answering(site: Site, hub: Hub, transport: Transport, clock: Clock, stack: ExitStack) -> tuple[Requests, SignIn]:
    """Answer people from now on; on a secured site whoever is revoked is signed out of the console."""
    security, sign_in = site.transport.security, SignIn(site.web.listen or "", clock)

    def said(sentence: str) -> None:
        sign_in.forget()
        if hub.audit:
            hub.audit.add("service", sentence)

    def reopen(access: Access) -> None:
        transport.reopen(access)
        if hub.keeper:
            hub.keeper.restart()

    if security is not None:
        stack.callback(KeyWatch(site, SERVICE, reopen, clock, lambda: any(r.playing for r in hub.burst_requests.values()), said).close)
    requests = Requests(hub, sign_in.invite if site.web.listen else None)
    requests.serve(*((None,) if security is None else (security.operators, security.tuners)))
    return requests, sign_in


def as_one_of_two(site: Site, second: bool) -> tuple[Site, Callable[[History], Standby] | None]:
    """Return the site as the first or ``second`` of its services serves it, and what makes its `Standby`; None for a site with one service.

    Raises `BadInput` for the second service of a site that has none.
    """
    transport = site.transport
    if second and not transport.standby:
        raise BadInput(f"{site.origin}: key 'transport.standby' is missing; with --standby it says where the second service listens")
    if not transport.standby:
        return site, None
    here, there = (transport.standby, transport.listen) if second else (transport.listen, transport.standby)
    other = transport.model_copy(update={"connect": there, "standby": []})
    own = transport.model_copy(update={"listen": here, "connect": here, "standby": []}) if second else transport.model_copy(update={"standby": []})
    grace = GRACE_SECONDS if second else 0.0
    return site.model_copy(update={"transport": own}), lambda history: Standby(other, Keys(site.site), history, grace)


@contextmanager
def _audited(site: Site, clock: Clock) -> Iterator[AuditLog]:
    """Open the audit log of a site; the start of the service, with the hash of its site file, and its end are in it."""
    log = AuditLog(audit_file(site), clock)
    log.add("service", "start", {"version": __version__, "pid": os.getpid(), "site_sha256": hashlib.sha256(site.text.encode()).hexdigest()})
    try:
        yield log
    finally:
        log.add("service", "stop")
        log.close()


def audit_file(site: Site) -> Path:
    """Return the file of a site's audit log, beside its recordings."""
    return site.recording.folder / f"{site.site}-audit.jsonl"


class SiteSinks:
    """The recordings of all machines and the one review of the site, and what went wrong with them."""

    def __init__(self, site: Site, clock: Clock) -> None:
        self._site, self._clock = site, clock
        self._recorders: list[tuple[RecorderSink, ThreadedSink]] = []
        self._review: tuple[ReviewSink, ThreadedSink] | None = None
        self._boxes: list[ThreadedSink] = []
        self._kept: list[PreAlarmBuffer] = []
        self.late: dict[str, tuple[Receipts, ThreadedSink]] = {}  # what rigs kept during an outage
        self._late: list[LateRecorder] = []
        self.posts: list[OutgoingQueue] = []  # what is sent to viewers and must arrive, so that its drops are counted too

    def of(self, machine: Commissioned) -> list[Sink]:
        """Return the sinks of one machine; the review is shared, one tab per machine."""
        id, site = machine.config.id, self._site
        facts = {"site": site.site}
        receipts = Receipts()
        recorder = RecorderSink(site.recording, id, site.text, machine.model_text(), self._clock.now_ns(), facts, receipts)
        late = LateRecorder(site.recording, id, site.text, machine.model_text(), facts, receipts)
        self._late.append(late)
        self.late[id] = receipts, ThreadedSink(late, f"late recorder of {id}", _teller("recording of what came late"))
        recording = ThreadedSink(recorder, f"recorder of {id}", _teller("recording"))
        self._recorders.append((recorder, recording))
        if self._review is None and site.review.rerun != "off":
            from afdsvc.present.rerun.log import (
                ReviewSink,  # Rerun takes seconds to import; a restart does not wait for it unasked
            )

            live = site.review.port if site.review.rerun == "live" else None
            review = ReviewSink(recorder.base.with_suffix(".rrd"), live)
            self._review = review, ThreadedSink(review, "review", _teller("review"))
        return [recording, *self._black_box(recorder, id), *([self._review[1]] if self._review else [])]

    def _black_box(self, recorder: RecorderSink, id: str) -> list[ThreadedSink]:
        """Return what keeps the time before an alarm, where the site wants that."""
        seconds = self._site.alarms.before_seconds
        if not seconds:
            return []
        box = PreAlarmBuffer(recorder.base.parent / "alarms" / recorder.base.name, recorder.header, seconds)
        self._boxes.append(ThreadedSink(box, f"black box of {id}", _teller("black box"), pause=0.5))
        self._kept.append(box)
        return self._boxes[-1:]

    def history(self) -> History:
        """Return the history of alarms, beside the recordings unless the site says where."""
        path = self._site.alarms.history or self._site.recording.folder / f"{self._site.site}-alarms.sqlite"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            _teller("alarm history")(f"{path.parent}: cannot be made: {error.strerror}")
        return History(path)

    def housekeeper(self) -> Housekeeper:
        """Return who closes what a killed service left and deletes what is too old; to be called before anything is recorded."""
        r, machines = self._site.recording, {m.id for m in self._site.machines}
        keep = Keep(r.keep_megabytes and 1e6 * r.keep_megabytes, r.keep_days and 86400 * r.keep_days)
        days = 86400 * self._site.alarms.keep_days
        history = self.history()

        def forget() -> None:
            history.forget(self._clock.now_ns() - round(1e9 * days))

        return Housekeeper(r.folder, keep, machines, self.writing, self._clock, alarms=Keep(seconds=days), chores=[forget], torn=self.torn)

    def summary(self) -> tuple[str, int, str, int]:
        """Return files, bytes and failure of the recordings, and the messages dropped anywhere on their way out."""
        files = ", ".join(str(r.paths[-1]) for r, _ in self._recorders if r.paths)
        failure = next((t.failure for _, t in self._recorders if t.failure), "")
        ways = [t for _, t in self._recorders] + [t for _, t in self.late.values()] + self._boxes + ([self._review[1]] if self._review else []) + self.posts
        return files, sum(r.bytes_written for r, _ in self._recorders), failure, sum(way.dropped for way in ways)

    def files(self) -> list[Path]:
        """Return every file written so far."""
        reviews = self._review[0].paths if self._review else []
        return [path for r, _ in self._recorders for path in r.paths] + [path for r in self._late for path in r.writing] + list(reviews)

    def writing(self) -> list[Path]:
        """Return every file that is being written."""
        reviews = self._review[0].paths[-1:] if self._review else []
        return [path for r, _ in self._recorders for path in r.writing] + [path for r in self._late for path in r.writing] + reviews

    def torn(self) -> list[Path]:
        """Return, once, the files that could not be written to their end."""
        left = [r.torn for r, _ in self._recorders] + [r.torn for r in self._late] + [box.torn for box in self._kept]
        return [torn.pop() for torn in left for _ in range(len(torn))]

    def close(self) -> None:
        """Finish every file."""
        sinks = [recording for _, recording in self._recorders] + [late for _, late in self.late.values()] + self._boxes + ([self._review[1]] if self._review else [])
        for sink in sinks:
            sink.leave()
        deadline = time.monotonic() + CLOSING_SECONDS
        for sink in sinks:
            sink.close(max(deadline - time.monotonic(), 0.05))


def _refuse_unkept(site: Site) -> None:
    """Raise `BadInput` where recordings or alarms can never be kept; a full disk may have room later and is reported while the service runs."""
    _refuse_unwritable(site, "recording.folder", site.recording.folder, site.recording.folder)
    if (history := site.alarms.history) is not None:
        _refuse_unwritable(site, "alarms.history", history, history.parent)
        if history.is_dir():
            raise BadInput(f"{site.origin}: key 'alarms.history' is '{history}', a folder; expected a file")


def _refuse_unwritable(site: Site, key: str, value: Path, folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            what = "a folder" if value == folder else "a file in a folder"
            raise BadInput(f"{site.origin}: key '{key}' is '{value}': {error.strerror}; expected {what} that can be made and written") from None


def _teller(what: str) -> Callable[[str], None]:
    return lambda why: log.error("%s: %s", what, why)


def open_outboxes(site: Site, history: History, plugins: Plugins) -> list[NotificationQueue]:
    """Return who hears of alarms: the history first, then every notifier of the site file."""
    opened = [(n.kind, plugins.get("notifiers", n.kind).open(n.settings)) for n in site.alarms.notify]
    return [NotificationQueue("the history", history.add, size=100_000, batch=500, patient=True)] + [NotificationQueue(name, _as_values(notify)) for name, notify in opened]


def _as_values(notify: Notify) -> Callable[[AlarmChange], None]:
    return lambda change: notify(json_values(change))
