"""The HTTP server behind the console and the metrics: a bounded number of connections, no traceback for a hang-up."""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from afdsvc.errors import BadInput

log = logging.getLogger(__name__)
CONNECTIONS = 32  # at a time; the oldest gives way to a new one
TIMEOUT_SECONDS = 5.0  # for the next bytes of a request


class BoundedServer(ThreadingHTTPServer):
    """Serves each connection in a thread, `CONNECTIONS` at most: one that is opened and left open is closed when others come."""

    daemon_threads = True
    request_queue_size = 128  # connections not yet accepted; beyond it a client tries again after 1, 2, 4 ... s

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self._open: dict[int, socket.socket] = {}
        self._places = threading.BoundedSemaphore(CONNECTIONS)
        self._lock = threading.Lock()
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Begin to serve a connection, where none is free once the thread of the oldest has ended."""
        if not self._places.acquire(blocking=False):
            with self._lock, contextlib.suppress(OSError, StopIteration):
                self._open.pop(next(iter(self._open))).shutdown(socket.SHUT_RDWR)
            self._places.acquire()
        request.settimeout(TIMEOUT_SECONDS)
        with self._lock:
            self._open[id(request)] = request
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """End a connection."""
        with self._lock:
            self._open.pop(id(request), None)
        super().shutdown_request(request)
        self._places.release()

    def server_close(self) -> None:
        """End every connection: a stream would go on."""
        super().server_close()
        with self._lock:
            for request in self._open.values():
                with contextlib.suppress(OSError):  # the peer was faster
                    request.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Note a connection that failed; a peer that hangs up is not an event of the service."""
        log.debug("a connection from %s failed", client_address, exc_info=True)


def serve_http(key: str, listen: str, handler: type[BaseHTTPRequestHandler]) -> Callable[[], None]:
    """Serve at ``host:port`` in threads; returns what stops it. Raises `BadInput` with the site file's key for a taken address."""
    host, _, port = listen.rpartition(":")
    try:
        server = BoundedServer((host, int(port)), handler)
    except (OSError, OverflowError) as error:
        raise BadInput(f"{key} = '{listen}': {error}; expected a free address of this computer") from None
    thread = threading.Thread(target=server.serve_forever, name=key, daemon=True)
    thread.start()

    def stop() -> None:
        server.shutdown()
        server.server_close()
        thread.join(5)

    return stop
