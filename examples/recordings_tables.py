"""A logger's table in any of five formats, with its own names, units and rate: one mapping file reads them all.

    python recordings_tables.py        # writes log.csv, log.parquet, log.mat, log73.mat, log.npz, axis.toml and mapping.toml
    afdsvc import log.mat -o log.mcap --mapping mapping.toml --model axis.toml
    afdsvc identify axis.toml log.parquet --mapping mapping.toml
"""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import scipy.io

from afdsvc.app.diagnose import import_recording

MODEL = """
name = "axis"
time = "discrete"
sample_time = 0.005
inputs = [{name = "force", unit = "N"}]
outputs = [{name = "position", unit = "mm"}]
A = [[0.9]]
B = [[0.1]]
C = [[1.0]]
D = [[0.0]]
"""
MAPPING = """
[time]
from = "Time_ms"
unit = "ms"
[signals]
u_force = {from = "Current", unit = "mA", factor = 2.5, factor_unit = "N/A"}
y_position = {from = "Pos", unit = "inch"}
aux_temperature = {from = "Temp", unit = "degC", to = "K"}
"""


def logged() -> dict[str, np.ndarray]:
    """Return ten seconds at 1 kHz: a current, the position that lags behind it, a temperature; half a second was lost."""
    t = np.arange(10_000) * 1e-3
    force = np.sin(2 * np.pi * 1.3 * t) + 0.5 * np.sin(2 * np.pi * 4.1 * t)
    position, lag = np.zeros(len(t)), 0.0
    for k, f in enumerate(force):
        position[k] = lag
        lag += (1 - np.exp(-1e-3 * 21)) * (f - lag)
    kept = (t < 4.0) | (t >= 4.5)
    columns = {"Time_ms": 1e3 * t, "Current": force / 2.5e-3, "Pos": position / 25.4, "Temp": 20 + 0.1 * t, "Counter": 1e3 * t}
    return {name: values[kept] for name, values in columns.items()}


def write(data: dict[str, np.ndarray]) -> list[str]:
    """Write the table in every format and return the files' names."""
    np.savetxt("log.csv", np.column_stack(list(data.values())), delimiter=",", header=",".join(data), comments="")
    pq.write_table(pa.table(data), "log.parquet")
    scipy.io.savemat("log.mat", data)
    with h5py.File("log73.mat", "w", userblock_size=512) as file:  # as MATLAB's save -v7.3 does
        for name, values in data.items():
            file[name] = values[None, :]
    np.savez("log.npz", **data)
    return ["log.csv", "log.parquet", "log.mat", "log73.mat", "log.npz"]


if __name__ == "__main__":
    Path("axis.toml").write_text(MODEL)
    Path("mapping.toml").write_text(MAPPING)
    for name in write(logged()):
        Path(f"{name}.mcap").unlink(missing_ok=True)  # recordings are not overwritten unasked
        made = import_recording(Path(name), Path(f"{name}.mcap"), Path("axis.toml"), {}, Path("mapping.toml"))
        print(f"{name}: {made['samples']} samples every {made['dt']} s in {made['pieces']} pieces, {', '.join(made['channels'])}")
    print(*made["notes"], sep="\n")
