"""The read-only web page of the running service, and its health for supervisors."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from importlib.resources import files
from typing import Any

from afdsvc.service.http_server import serve_http
from afdsvc.service.hub import Hub
from afdsvc.service.operator_requests import json_values

log = logging.getLogger(__name__)
DECISIONS = 60  # of each machine shown on the page
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src 'self'; base-uri 'none'"


def seen(hub: Hub) -> dict[str, Any]:
    """Return everything the page shows as JSON values."""
    return {
        "status": json_values(hub.status()),
        "alarms": json_values(list(hub.alarms.alarms.values())),
        "decisions": {id: json_values(list(watch.evidence)[-DECISIONS:]) for id, watch in hub.watches.items()},
    }


def probes(hub: Hub) -> dict[str, bool]:
    """Return by path whether the service is healthy (its threads come round) and ready (and it records what it hears)."""
    healthy = hub.healthy()
    return {"/healthz": healthy, "/readyz": healthy and not hub.status().recording_failure}


class _Handler(BaseHTTPRequestHandler):
    """Answers GET and HEAD for the page, its figures and the health of the service, and nothing else."""

    show: Callable[[], Mapping[str, Any]]
    probe: Callable[[], Mapping[str, bool]]
    hosts: tuple[str, ...]
    server_version, sys_version = "afdsvc", ""

    def do_GET(self) -> None:
        """Answer with the body."""
        self._answer(True)

    def do_HEAD(self) -> None:
        """Answer without the body."""
        self._answer(False)

    def _answer(self, whole: bool) -> None:
        # A page elsewhere whose name resolves to this computer must not read what is only meant for it.
        if self.headers.get("Host", "").rsplit(":", 1)[0] not in self.hosts:
            return self.send_error(HTTPStatus.FORBIDDEN, "the page is not served under this host name")
        kind, body, status = self._content()
        if not kind:
            return self.send_error(HTTPStatus.NOT_FOUND)
        self.send_response(status)
        headers = {"Content-Type": kind, "Content-Length": str(len(body)), "Cache-Control": "no-store"}
        for name, value in (headers | {"Content-Security-Policy": POLICY, "X-Content-Type-Options": "nosniff"}).items():
            self.send_header(name, value)
        self.end_headers()
        if whole:
            self.wfile.write(body)

    def _content(self) -> tuple[str, bytes, HTTPStatus]:
        if self.path == "/":
            return "text/html; charset=utf-8", files("afdsvc.service").joinpath("page.html").read_bytes(), HTTPStatus.OK
        if self.path == "/now.json":
            return "application/json", json.dumps(type(self).show(), allow_nan=False).encode(), HTTPStatus.OK
        if self.path in ("/healthz", "/readyz"):
            good = type(self).probe()[self.path]
            return "text/plain", b"yes\n" if good else b"no\n", HTTPStatus.OK if good else HTTPStatus.SERVICE_UNAVAILABLE
        return "", b"", HTTPStatus.NOT_FOUND

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are not logged."""
        log.debug(format, *args)


def serve_page(listen: str, hub: Hub) -> Callable[[], None]:
    """Serve the page at ``host:port`` in threads of its own; returns what stops it.

    Raises `BadInput` when the address cannot be listened at.
    """
    host = listen.rpartition(":")[0]
    names = (host, "localhost", "127.0.0.1") if host.startswith("127.") or host == "localhost" else (host,)
    members = {"show": staticmethod(lambda: seen(hub)), "probe": staticmethod(lambda: probes(hub)), "hosts": names}
    return serve_http("web.listen", listen, type("Handler", (_Handler,), members))
