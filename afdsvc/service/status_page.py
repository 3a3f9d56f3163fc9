"""The read-only web page of the running service."""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any

from afdsvc.errors import BadInput
from afdsvc.service.hub import Hub
from afdsvc.service.operator_requests import plain

log = logging.getLogger(__name__)
DECISIONS = 60  # of each machine shown on the page
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src 'self'; base-uri 'none'"


def seen(hub: Hub) -> dict[str, Any]:
    """Return everything the page shows as JSON values."""
    return {
        "status": plain(hub.status()),
        "alarms": plain(list(hub.alarms.alarms.values())),
        "decisions": {id: plain(list(watch.evidence)[-DECISIONS:]) for id, watch in hub.watches.items()},
    }


class _Handler(BaseHTTPRequestHandler):
    """Answers GET and HEAD for the page and its figures, and nothing else."""

    show: Callable[[], Mapping[str, Any]]
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
        kind, body = self._content()
        if not kind:
            return self.send_error(HTTPStatus.NOT_FOUND)
        self.send_response(HTTPStatus.OK)
        headers = {"Content-Type": kind, "Content-Length": str(len(body)), "Cache-Control": "no-store"}
        for name, value in (headers | {"Content-Security-Policy": POLICY, "X-Content-Type-Options": "nosniff"}).items():
            self.send_header(name, value)
        self.end_headers()
        if whole:
            self.wfile.write(body)

    def _content(self) -> tuple[str, bytes]:
        if self.path == "/":
            return "text/html; charset=utf-8", files("afdsvc.service").joinpath("page.html").read_bytes()
        if self.path == "/now.json":
            return "application/json", json.dumps(type(self).show(), allow_nan=False).encode()
        return "", b""

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are not logged."""
        log.debug(format, *args)


def serve_page(listen: str, hub: Hub) -> Callable[[], None]:
    """Serve the page at ``host:port`` in threads of its own; returns what stops it.

    Raises `BadInput` when the address cannot be listened at.
    """
    host, _, port = listen.rpartition(":")
    names = (host, "localhost", "127.0.0.1") if host.startswith("127.") or host == "localhost" else (host,)
    handler = type("Handler", (_Handler,), {"show": staticmethod(lambda: seen(hub)), "hosts": names})
    try:
        server = ThreadingHTTPServer((host, int(port)), handler)
    except (OSError, OverflowError) as error:
        raise BadInput(f"web.listen = '{listen}': {error}; expected a free address of this computer") from None
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, name="web", daemon=True)
    thread.start()

    def stop() -> None:
        server.shutdown()
        server.server_close()
        thread.join(5)

    return stop
