"""The operator's console: a page that anybody who reaches it may read, and on which people who are signed in may act.

People sign in with a link that works once and that the service hands out over the site's own transport (``afdsvc console``), so the access rules
of the site decide who they are. What they ask on the page is checked and audited like any other request.
"""

from __future__ import annotations

import json
import re
import secrets
import shutil
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from functools import lru_cache
from http import HTTPStatus
from http.cookies import SimpleCookie
from http.server import BaseHTTPRequestHandler
from importlib.resources import files
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from afdsvc.api.clock import Clock
from afdsvc.diagnosis.trend import forecast
from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.service.http_server import serve_http
from afdsvc.service.hub import Hub
from afdsvc.service.machine import MachineMonitor
from afdsvc.service.operator_requests import Requests, json_values
from afdsvc.wire.messages import Alarm

DECISIONS = 60  # of each machine shown on the page
POINTS = 240  # of a curve
BLOCKS = 1200  # of which the residual is kept
DAY = 86400.0
INVITED_SECONDS, SIGNED_IN_SECONDS = 300.0, 8 * 3600.0
PEOPLE = 100  # invited or signed in at a time; the oldest gives way
LONGEST_REQUEST = 10_000  # bytes
STREAMS = 16  # pages that hear at once what changes, half of all connections; further ones ask every 2 s
STREAM_SECONDS, LEAST_SECONDS = 1.0, 0.25  # between two events of a stream, and when something has changed
TRENDS_EVERY = 10  # events
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"


class SignIn:
    """Who may act on the page: invitations that work once, and people known afterwards by a cookie. Any thread may call."""

    def __init__(self, listen: str, clock: Clock) -> None:
        self._listen, self._clock, self._lock = listen, clock, threading.Lock()
        self._invited: dict[str, tuple[str, float]] = {}
        self._people: dict[str, tuple[str, float]] = {}

    def invite(self, who: str) -> dict[str, str]:
        """Return the link by which a person signs in, once and soon."""
        return {"url": f"http://{self._listen}/sign-in/{self._kept(self._invited, who, INVITED_SECONDS)}", "who": who}

    def enter(self, token: str) -> str:
        """Return the session an invitation opens; raises `BadInput` for one that is used or old."""
        with self._lock:
            who, until = self._invited.pop(token, ("", 0.0))
        if not who or self._clock.monotonic() > until:
            raise BadInput("this link has been used, or is older than 5 minutes; ask for another one with 'afdsvc console'")
        return self._kept(self._people, who, SIGNED_IN_SECONDS)

    def who(self, session: str) -> str:
        """Return the person of a session, "" for none."""
        with self._lock:
            who, until = self._people.get(session, ("", 0.0))
        return who if self._clock.monotonic() <= until else ""

    def forget(self) -> None:
        """End every session and invitation."""
        with self._lock:
            self._invited.clear()
            self._people.clear()

    def _kept(self, where: dict[str, tuple[str, float]], who: str, seconds: float) -> str:
        name = secrets.token_urlsafe(24)
        with self._lock:
            where[name] = who, self._clock.monotonic() + seconds
            for old in list(where)[:-PEOPLE]:
                del where[old]
        return name


def seen(hub: Hub, who: str = "", folder: Path = Path()) -> dict[str, Any]:
    """Return everything the page shows as JSON values; files only to those who are signed in."""
    alarms = list(hub.alarms.alarms.values())
    return {
        "status": json_values(hub.status()), "who": who,
        "alarms": [{**json_values(a), "seen": str(a.since_ns)} for a in alarms],  # a browser's numbers hold 53 bits
        "files": {a.id: files_of(a, folder) for a in alarms} if who else {},
        "decisions": {id: [{**json_values(f.evidence), "t_ns": f.t_ns} for f in list(watch.findings)[-DECISIONS:]] for id, watch in hub.watches.items()},
        "residuals": {id: residual(watch) for id, watch in hub.watches.items()},
        "bursts": {id: {"playing": r.playing, "paused": r.scheduler.paused, "may_retune": id in hub.retunings} for id, r in hub.burst_requests.items()},
    }  # fmt: skip


def residual(watch: MachineMonitor) -> dict[str, list[float]]:
    """Return the residual of the last blocks: its energy over the threshold that noise alone exceeds once a day, against the machine's time [s].

    Without a fault ``r' Sigma^-1 r`` summed over the ``n`` samples of a block is chi-square with ``n p`` degrees of freedom.
    """
    blocks = list(watch.residuals or ())
    try:
        problem = watch.pipeline.problem
    except AfdsvcError:  # no noise is known yet
        return {"t": [], "level": [], "burst": []}
    if not blocks:
        return {"t": [], "level": [], "burst": []}
    t, n, burst = (np.array([block[k] for block in blocks]) for k in range(3))
    S = np.concatenate([block[3] for block in blocks]).reshape(len(blocks), *problem.covariance.shape)
    most = {int(k): _threshold(int(k), len(problem.covariance), DAY / (k * problem.plant.dt)) for k in set(n.tolist())}
    level = (S * np.linalg.inv(problem.covariance)).sum((1, 2)) / np.array([most[k] for k in n.tolist()])
    step = max(1, len(t) // POINTS)
    worst = np.array([i + int(np.argmax(level[i : i + step])) for i in range(0, len(t), step)])
    return {"t": t[worst].tolist(), "level": level[worst].tolist(), "burst": burst[worst].astype(float).tolist()}


@lru_cache(maxsize=64)
def _threshold(n: int, outputs: int, blocks: float) -> float:
    return float(chi2.isf(1 / blocks, n * outputs))


def trends(hub: Hub, limit: float) -> dict[str, Any]:
    """Return by machine the judged bursts and, for the fault that was found last, when it reaches the limit."""
    return {id: _trend(hub, id, limit) for id in hub.watches} if hub.history else {}


def _trend(hub: Hub, machine: str, limit: float) -> dict[str, Any]:
    rows = hub.history.judged(machine) if hub.history else []
    sized = [r for r in rows if r.value is not None and r.sd]
    fault = sized[-1].fault if sized else ""
    own = [r for r in sized if r.fault == fault]
    found = forecast([r.t_ns / 1e9 / DAY for r in own], [r.value or 0.0 for r in own], [r.sd or 0.0 for r in own], limit)
    few = sized[:: max(1, len(sized) // POINTS)]
    points = [{"t_ns": r.t_ns, "fault": r.fault, "value": r.value, "sd": r.sd} for r in few]
    return {"bursts": len(rows), "fault": fault, "limit": limit, "points": points, "forecast": json_values(found)}


def files_of(alarm: Alarm, folder: Path) -> dict[str, str]:
    """Return the names of the recording and the review an alarm lies in, and of the file of the time before it, as far as they are there."""
    own = re.compile(re.escape(alarm.machine) + r"-\d{8}T\d{6}[-.\w]*")
    fault = re.sub(r"[^A-Za-z0-9_.-]", "_", alarm.fault)
    places = {
        "recording": [p for p in folder.glob("*.mcap") if own.fullmatch(p.name)], "review": list(folder.glob("*.rrd")),
        "before": [p for p in folder.glob(f"alarms/*-{fault}.mcap") if own.fullmatch(p.name)],
    }  # fmt: skip
    found: dict[str, str] = {}
    for kind, paths in places.items():
        later = sorted((p.stat().st_mtime_ns, p.relative_to(folder).as_posix()) for p in paths)
        if later:  # the newest file may have been written to before the alarm for the last time so far
            found[kind] = next((name for t_ns, name in later if t_ns >= alarm.since_ns), later[-1][1])
    return found


def probes(hub: Hub) -> dict[str, bool]:
    """Return by path whether the service is healthy (its threads come round) and ready (and it records what it hears)."""
    healthy = hub.healthy()
    return {"/healthz": healthy, "/readyz": healthy and not hub.status().recording_failure}


Answer = tuple[HTTPStatus, str, bytes]


class _Handler(BaseHTTPRequestHandler):
    """Answers for the page, its figures, the files of people who are signed in, what they ask, and the health of the service; nothing else."""

    hub: Hub
    requests: Requests
    sign_in: SignIn
    folder: Path
    limit: float
    hosts: tuple[str, ...]
    streams: threading.Semaphore
    server_version, sys_version = "afdsvc", ""

    def do_GET(self) -> None:
        """Answer with the body."""
        self._answer(True)

    def do_HEAD(self) -> None:
        """Answer without the body."""
        self._answer(False)

    def do_POST(self) -> None:
        """Do what a person who is signed in asks on the page: ``{"name": ..., "arguments": {...}}``."""
        if self._is_foreign():
            return
        # A form of another page cannot set this header, and its request would come without the cookie.
        if self.path != "/act" or self.headers.get("X-Requested-With") != "afdsvc":
            return self.send_error(HTTPStatus.NOT_FOUND)
        if not (who := self._who()):
            return self._reply(HTTPStatus.UNAUTHORIZED, {"ok": False, "error": "you are not signed in; 'afdsvc console' prints a link"})
        try:
            size = int(self.headers.get("Content-Length", ""))
            asked: Any = json.loads(self.rfile.read(size)) if 0 < size <= LONGEST_REQUEST else None
            name, arguments = str(asked["name"]), dict(asked["arguments"])
        except (ValueError, KeyError, TypeError):
            return self._reply(HTTPStatus.BAD_REQUEST, {"ok": False, "error": "expected a JSON object with name and arguments"})
        reply = self.requests.on_page(who, name, arguments)
        self._reply(HTTPStatus.OK, {"ok": reply.ok, "result": reply.result, "error": reply.error})

    def _reply(self, status: HTTPStatus, value: Any) -> None:
        self._send((status, "application/json", json.dumps(value, allow_nan=False).encode()))

    def _who(self) -> str:
        cookie = SimpleCookie(self.headers.get("Cookie", "")).get(self._cookie)
        return self.sign_in.who(cookie.value) if cookie else ""

    @property
    def _cookie(self) -> str:
        return f"afdsvc-{self.hub.keys.site}"

    def _is_foreign(self) -> bool:
        """Refuse a page elsewhere whose name resolves to this computer: it must not read what is only meant for it."""
        foreign = self.headers.get("Host", "").rsplit(":", 1)[0] not in self.hosts
        if foreign:
            self.send_error(HTTPStatus.FORBIDDEN, "the page is not served under this host name")
        return foreign

    def _answer(self, whole: bool) -> None:
        if self._is_foreign():
            return
        if self.path.startswith("/sign-in/"):
            return self._enter(self.path.removeprefix("/sign-in/")) if whole else self.send_error(HTTPStatus.METHOD_NOT_ALLOWED)
        if self.path.startswith("/files/"):
            return self._send_file(self.path.removeprefix("/files/"), whole)
        if self.path == "/events" and whole:
            return self._stream()
        found = self._content()
        return self._send(found, whole=whole) if found else self.send_error(HTTPStatus.NOT_FOUND)

    def _content(self) -> Answer | None:
        match self.path:
            case "/":
                return HTTPStatus.OK, "text/html; charset=utf-8", files("afdsvc.service").joinpath("console.html").read_bytes()
            case "/now.json":
                return HTTPStatus.OK, "application/json", self._now()
            case "/trends.json":
                return HTTPStatus.OK, "application/json", self._trends()
            case "/healthz" | "/readyz":
                good = probes(self.hub)[self.path]
                return HTTPStatus.OK if good else HTTPStatus.SERVICE_UNAVAILABLE, "text/plain", b"yes\n" if good else b"no\n"
        return None

    def _now(self) -> bytes:
        return json.dumps(seen(self.hub, self._who(), self.folder), allow_nan=False).encode()

    def _trends(self) -> bytes:
        return json.dumps(trends(self.hub, self.limit), allow_nan=False).encode()

    def _stream(self) -> None:
        """Send what the page shows as server-sent events, each second and when an alarm or a decision changes, until the page leaves."""
        if not self.streams.acquire(blocking=False):
            return self.send_error(HTTPStatus.SERVICE_UNAVAILABLE, "as many pages as possible are open; this one asks every 2 s")
        try:
            self._begin(HTTPStatus.OK, {"Content-Type": "text/event-stream", "X-Accel-Buffering": "no"})  # a proxy that waits for more would keep it
            for number in count():
                known = self.hub.changes
                self._push("now", self._now())
                if number % TRENDS_EVERY == 0:
                    self._push("trends", self._trends())
                time.sleep(LEAST_SECONDS)
                self.hub.wait_for_change(known, STREAM_SECONDS - LEAST_SECONDS)
        finally:
            self.streams.release()

    def _push(self, name: str, value: bytes) -> None:
        self.wfile.write(b"event: %s\ndata: %s\n\n" % (name.encode(), value))

    def _enter(self, token: str) -> None:
        try:
            session = self.sign_in.enter(token)
        except BadInput as error:
            return self._send((HTTPStatus.UNAUTHORIZED, "text/plain; charset=utf-8", f"{error}\n".encode()))
        cookie = f"{self._cookie}={session}; HttpOnly; SameSite=Strict; Path=/; Max-Age={SIGNED_IN_SECONDS:.0f}"
        self._send((HTTPStatus.SEE_OTHER, "text/plain", b""), {"Location": "/", "Set-Cookie": cookie})

    def _send_file(self, name: str, whole: bool) -> None:
        known = {found for a in self.hub.alarms.alarms.values() for found in files_of(a, self.folder).values()}
        if not self._who() or name not in known:
            return self.send_error(HTTPStatus.NOT_FOUND)
        path = self.folder / name
        with path.open("rb") as file:
            headers = {"Content-Disposition": f'attachment; filename="{path.name}"'}
            self._send((HTTPStatus.OK, "application/octet-stream", b""), headers, path.stat().st_size, whole=False)
            if whole:
                shutil.copyfileobj(file, self.wfile)

    def _send(self, answer: Answer, headers: Mapping[str, str] | None = None, size: int | None = None, whole: bool = True) -> None:
        status, kind, body = answer
        self._begin(status, {"Content-Type": kind, "Content-Length": str(len(body) if size is None else size), **(headers or {})})
        if whole:
            self.wfile.write(body)

    def _begin(self, status: HTTPStatus, headers: Mapping[str, str]) -> None:
        self.send_response(status)
        common = {"Cache-Control": "no-store", "Content-Security-Policy": POLICY, "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer"}
        for name, value in {**headers, **common}.items():
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are not logged: a link to sign in must not end in a log."""


def serve_console(listen: str, hub: Hub, requests: Requests, sign_in: SignIn, folder: Path, limit: float) -> Callable[[], None]:
    """Serve the console at ``host:port`` in threads of its own; returns what stops it. Raises `BadInput` when the address cannot be listened at.

    ``folder`` is that of the recordings, ``limit`` the severity trends are forecast to.
    """
    for watch in hub.watches.values():
        watch.residuals = deque(maxlen=BLOCKS)
    host = listen.rpartition(":")[0]
    names = (host, "localhost", "127.0.0.1") if host.startswith("127.") or host == "localhost" else (host,)
    members = {"hub": hub, "requests": requests, "sign_in": sign_in, "folder": folder, "limit": limit, "hosts": names, "streams": threading.Semaphore(STREAMS)}
    return serve_http("web.listen", listen, type("Handler", (_Handler,), members))
