"""Several rig agents in one process: ``python benchmarks/soak/rigs.py SITE.toml ID...`` until SIGTERM."""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path

from afdsvc.app.rig import run_rig
from afdsvc.files.site import read_site


def main() -> None:
    """Run one thread for each machine."""
    site, stop = read_site(Path(sys.argv[1])), threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    threads = [threading.Thread(target=run_rig, args=(site, id, None, stop), daemon=True) for id in sys.argv[2:]]
    for thread in threads:
        thread.start()
    while any(t.is_alive() for t in threads):
        stop.wait(0.5)
        if stop.is_set():
            for thread in threads:
                thread.join(5)
            os._exit(0)  # a thread that waits for a dead network would make the interpreter abort


if __name__ == "__main__":
    main()
