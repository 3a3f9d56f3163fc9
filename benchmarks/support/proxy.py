"""A network that can be stalled, cut and mended: a TCP proxy to a port of this computer."""

from __future__ import annotations

import contextlib
import socket
import threading


class Proxy:
    """Forwards its ``port`` to another port of this computer. A stalled one passes nothing on, a cut one has no connections."""

    def __init__(self, target: int, port: int = 0, host: str = "127.0.0.1") -> None:
        self._target, self._flowing, self._reachable = target, threading.Event(), True
        self._flowing.set()
        self._pairs: list[tuple[socket.socket, socket.socket]] = []
        self._lock = threading.Lock()
        self._listener = socket.create_server((host, port))
        self.port = int(self._listener.getsockname()[1])
        threading.Thread(target=self._accept, name="proxy", daemon=True).start()

    def stall(self) -> None:
        """Pass nothing on, keeping every connection open."""
        self._flowing.clear()

    def cut(self) -> None:
        """Drop every connection and refuse new ones."""
        self._reachable = False
        self._drop()

    def mend(self) -> None:
        """Pass everything on again and take connections."""
        self._reachable = True
        self._flowing.set()

    def close(self) -> None:
        """Stop for good."""
        self.cut()
        self._flowing.set()
        self._listener.close()

    def _drop(self) -> None:
        with self._lock:
            pairs, self._pairs = self._pairs, []
        for pair in pairs:
            for end in pair:
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            try:
                if not self._reachable:
                    raise OSError("the network is cut")
                far = socket.create_connection(("127.0.0.1", self._target), timeout=2)
                far.settimeout(None)
            except OSError:
                near.close()
                continue
            with self._lock:
                self._pairs.append((near, far))
            for source, sink in ((near, far), (far, near)):
                threading.Thread(target=self._pump, args=(source, sink), name="proxy pump", daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket) -> None:
        try:
            while data := source.recv(65536):
                self._flowing.wait()
                sink.sendall(data)
        except OSError:
            pass
        finally:
            for end in (source, sink):
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
            source.close()
