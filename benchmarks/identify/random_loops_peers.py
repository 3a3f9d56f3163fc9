"""PARSIM-K on the loops that `random_loops --keep FOLDER` has written; run with the Python of an environment that holds sippy (see `peers`).

    peers/bin/python benchmarks/identify/random_loops_peers.py FOLDER

Horizons of 20 samples. The order is the true one, or chosen from 1 to 12 by BIC; of both the smaller error counts, as if somebody knew which.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import resource
import sys
import time
import warnings
from pathlib import Path

import numpy as np
from peers import LONGEST

OMEGA = np.geomspace(0.02, 3.0, 80)  # rad/sample, as in `random_loops`


def response(A, B, C, D):
    """Return the frequency response ``(frequencies, p, m)`` of a discrete system."""
    return np.array([C @ np.linalg.solve(np.exp(1j * w) * np.eye(len(A)) - A, B) + D for w in OMEGA])


def _run(path: Path, queue: multiprocessing.Queue) -> None:
    warnings.filterwarnings("ignore")
    resource.setrlimit(resource.RLIMIT_CPU, (LONGEST, LONGEST))
    from sippy_unipi import system_identification

    data = np.load(path)
    truth = response(*(data[k] for k in "ABCD"))
    for size in ({"SS_fixed_order": len(data["A"])}, {"IC": "BIC", "SS_orders": [1, 12]}):
        start = time.process_time()
        with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
            m = system_identification(data["y"].T.copy(), data["u"].T.copy(), "PARSIM-K", SS_D_required=bool(data["D"].any()), SS_f=20, SS_p=20, **size)
        found = response(*(np.asarray(part, dtype=float) for part in (m.A, m.B, m.C, m.D)))
        gap = np.linalg.norm(found - truth, 2, axis=(1, 2)) / np.linalg.norm(truth, 2, axis=(1, 2))
        queue.put((float(np.median(gap)), time.process_time() - start))


def measured(path: Path) -> list[tuple[float, float]]:
    """Return median error and seconds of processor time with the true order and with BIC, as far as the tool comes."""
    queue: multiprocessing.Queue = multiprocessing.Queue()
    process = multiprocessing.Process(target=_run, args=(path, queue))
    process.start()
    process.join()
    return [queue.get() for _ in range(queue.qsize())]


if __name__ == "__main__":
    for path in sorted(Path(sys.argv[1]).glob("*.npz"), key=lambda p: int(p.stem)):
        found = measured(path)
        print(f"{path.stem:>3}", *(f"{100 * error:7.2f} % {seconds:5.1f} s" for error, seconds in found), flush=True)
