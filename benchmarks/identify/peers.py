"""Fit of other tools on the public sets; run with the Python of an environment that holds them.

    python -m venv peers; peers/bin/pip install sippy_unipi==1.0.1 llsi==0.5.0 sysidentpy==0.9.0 control==0.10.2
    AFDSVC_DATA=folder peers/bin/python benchmarks/identify/peers.py peers.csv [set ...]

sippy chooses the order from 1 to 12 by BIC, with feedthrough; SysIdentPy chooses the terms of an ARX model by BIC; llsi and markov + ERA, which choose
nothing, are given `ORDERS`. A tool that raises, gives no number, or takes longer than `LONGEST` counts as failed.
"""

from __future__ import annotations

import contextlib
import csv
import multiprocessing
import os
import resource
import sys
import time
import warnings
from pathlib import Path

import numpy as np
from public_sets import PublicSet, fit, from_environment

#: Order for tools that choose none.
ORDERS = {
    "CD player arm": 12, "ball and beam": 3, "flutter": 6, "steam generator": 9, "winding": 4, "CSTR": 3, "evaporator": 4, "glass furnace": 5,
    "thermic wall": 3, "pH": 3, "cascaded tanks": 3, "Silverbox": 2, "two-mass A": 6, "two-mass B": 6,
}  # fmt: skip
#: Seconds of processor time after which a tool is ended.
LONGEST = 120


def sippy(method, data: PublicSet, order: int, fixed: bool = False):
    from sippy_unipi import system_identification

    size = {"SS_fixed_order": order} if fixed else {"IC": "BIC", "SS_orders": [1, 12]}
    m = system_identification(data.y.T.copy(), data.u.T.copy(), method, SS_D_required=True, SS_f=20, SS_p=20, **size)
    return m.A, m.B, m.C, m.D


def llsi(data: PublicSet, order: int):
    from llsi import SysIdData, sysid

    columns = {f"u{k}": c for k, c in enumerate(data.u.T)} | {f"y{k}": c for k, c in enumerate(data.y.T)}
    m = sysid(SysIdData(Ts=1.0, **columns), [c for c in columns if c[0] == "y"], [c for c in columns if c[0] == "u"], order, method="po-moesp")
    return m.A, m.B, m.C, m.D


def era(data: PublicSet, order: int):
    import control

    count = min(80, len(data.u) // (4 * data.u.shape[1]))
    H = np.atleast_3d(control.markov(data.y.T, data.u.T, m=count, dt=1.0)).reshape(data.y.shape[1], data.u.shape[1], count)
    m, _ = control.eigensys_realization(H, order, dt=1.0)
    return m.A, m.B, m.C, m.D


def arx(data: PublicSet, order: int, lags: int = 12):
    """Return the state space of SysIdentPy's polynomial of degree 1, an output at a time: states are the last outputs and inputs."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    (_, inputs), outputs = data.u.shape, data.y.shape[1]
    own = lags * (1 + inputs)
    A, B, C = np.zeros((own * outputs, own * outputs)), np.zeros((own * outputs, inputs)), np.zeros((outputs, own * outputs))
    for i, y in enumerate(data.y.T):
        model = FROLS(ylag=lags, xlag=[list(range(1, lags + 1))] * inputs if inputs > 1 else lags, info_criteria="bic", n_info_values=own,
                      estimator=LeastSquares(), basis_function=Polynomial(degree=1))  # fmt: skip
        model.fit(X=data.u, y=y[:, None])
        row = np.zeros(own)
        for (code,), value in zip(model.final_model, np.ravel(model.theta), strict=True):
            if code:
                row[(code // 1000 - 1) * lags + code % 1000 - 1] = value
        at = i * own
        C[i, at : at + own] = row
        A[at, at : at + own] = row
        for part in range(1 + inputs):
            start = at + part * lags
            A[start + 1 : start + lags, start : start + lags - 1] = np.eye(lags - 1)
            if part:
                B[start, part - 1] = 1.0
    return A, B, C, np.zeros((outputs, inputs))


TOOLS = {
    "sippy N4SID": lambda d, n: sippy("N4SID", d, n),
    "sippy CVA": lambda d, n: sippy("CVA", d, n),
    "sippy PARSIM-K": lambda d, n: sippy("PARSIM-K", d, n),
    "llsi PO-MOESP": llsi,
    "markov + ERA": era,
    "SysIdentPy ARX": arx,
}


def _run(tool: str, name: str, queue: multiprocessing.Queue) -> None:
    warnings.filterwarnings("ignore")
    resource.setrlimit(resource.RLIMIT_CPU, (LONGEST, LONGEST))
    data, start = from_environment()[name](), time.process_time()
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
        A, B, C, D = (np.asarray(part, dtype=float) for part in TOOLS[tool](data, ORDERS[name]))
    queue.put((fit(A, B, C, D, data), len(A), time.process_time() - start))


def measured(tool: str, name: str) -> tuple[float, int, float]:
    """Return fit in per cent, order and seconds of processor time of a tool on a set, in a process of its own; -inf where it failed."""
    queue: multiprocessing.Queue = multiprocessing.Queue()
    process = multiprocessing.Process(target=_run, args=(tool, name, queue))
    process.start()
    process.join()
    return queue.get() if process.exitcode == 0 and not queue.empty() else (-np.inf, 0, np.nan)


if __name__ == "__main__":
    with Path(sys.argv[1]).open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["set", "tool", "fit", "order", "seconds"])
        for name in sys.argv[2:] or from_environment():
            for tool in TOOLS:
                value, order, seconds = measured(tool, name)
                table.writerow([name, tool, f"{value:.2f}", order, f"{seconds:.2f}"])
                file.flush()
                print(f"{name:18s} {tool:16s} {value:8.2f} {order:3d} {seconds:7.2f} s", flush=True)
