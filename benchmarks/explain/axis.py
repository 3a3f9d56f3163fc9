"""How near `explain` comes to what any dry-friction model of the measured positioning axis can reach.

    AFDSVC_DATA=DATA python benchmarks/explain/axis.py

The measure is the published one: the force of the drive in closed loop, its position and velocity loops closed around the
model, against the measured force (A. Janot, M. Gautier, M. Brunot, "Data set and reference models of EMPS", 2019). Rows:
the published parameters; what `explain` found on `estimation`; the same structure fitted to this very measure on
`estimation`; the same fitted on `pulses` itself, which no method that keeps `pulses` unseen can beat; and the structure with one
more term, a viscous friction that depends on the direction, fitted on `estimation`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numba import njit
from scipy.linalg import expm
from scipy.optimize import minimize

from afdsvc.api.signals import Trace
from afdsvc.explain.pipeline import explain
from afdsvc.files.model.model_file import read_model
from afdsvc.files.tables.tables import read_table
from afdsvc.plugins.physics import afdsvc_physics

KP, KV, VOLTS, GAIN = 160.18, 243.45, 10.0, 35.15
M = 95.1089
PUBLISHED = np.array([203.5034 / M, 1 / M, 20.3935 / M, 3.1648 / M, 0.0])  # viscous, 1 / mass, Coulomb, offset, direction
ROUNDING = 1e-5  # m/s


@njit(cache=True)
def closed(phi, gamma, push, p, ref, u, q, dt):
    """Return the relative error of the force when the loop is closed around the model."""
    n = len(u)
    x0, x1, before, measured_before = q[0], 0.0, q[0], q[0]
    wrong = size = 0.0
    for k in range(n):
        said = GAIN * min(max(KP * KV * (ref[k] - q[k]) - KV * (q[k] - measured_before) / dt, -VOLTS), VOLTS)
        force = GAIN * min(max(KP * KV * (ref[k] - x0) - KV * (x0 - before) / dt, -VOLTS), VOLTS) + u[k] - said
        before, measured_before = x0, q[k]
        rest = -p[2] * np.tanh(x1 / (ROUNDING + p[2] * dt)) + p[3] + p[4] * abs(x1)
        x0, x1 = (
            phi[0, 0] * x0 + phi[0, 1] * x1 + gamma[0] * force + push[0] * rest,
            phi[1, 0] * x0 + phi[1, 1] * x1 + gamma[1] * force + push[1] * rest,
        )
        wrong += (u[k] - force) ** 2
        size += u[k] ** 2
    return np.sqrt(wrong / size)


def error(p: np.ndarray, trace: Trace) -> float:
    """Return the relative force error of parameters ``p`` (as `PUBLISHED`) on a recording."""
    A = np.zeros((4, 4))
    A[0, 1], A[1] = 1.0, (0.0, -p[0], p[1], 1.0)
    step = expm(A * trace.dt)
    ref, u, q = (np.ascontiguousarray(trace.column(c)) for c in ("ref_position", "u_force", "y_position"))
    parts = [np.ascontiguousarray(M) for M in (step[:2, :2], step[:2, 2], step[:2, 3])]
    return float(closed(*parts, p, ref, u, q, trace.dt))


def fitted(trace: Trace, free: int) -> np.ndarray:
    """Return the first ``free`` parameters fitted to the force error on a recording, the others as published."""
    start = np.where(PUBLISHED == 0, 0.1, PUBLISHED)

    def cost(scale: np.ndarray) -> float:
        p = PUBLISHED.copy()
        p[:free] = start[:free] * scale
        return error(p, trace)

    best = minimize(cost, np.ones(free), method="Nelder-Mead", options={"maxfev": 1500, "xatol": 1e-4, "fatol": 1e-7, "adaptive": True})
    p = PUBLISHED.copy()
    p[:free] = start[:free] * best.x
    return p


def found(folder: Path, trace: Trace) -> np.ndarray:
    """Return what `explain` makes of the recording, in the same parameters."""
    answer = explain(read_model(folder / "model.toml"), [trace], [read_table(folder / "pulses.csv")], afdsvc_physics())
    plant, effects = answer.nominal.at(answer.point.theta), {e.hypothesis.physics: e.values for e in answer.point.effects}
    return np.array([-plant.A[1, 1], plant.B[1, 0], effects["coulomb_friction"][0], effects.get("constant_load", effects.get("nuisance", [0.0]))[0], 0.0])


def main() -> None:
    """Print the table."""
    folder = Path(os.environ["AFDSVC_DATA"]) / "emps"
    estimation, pulses = read_table(folder / "estimation.csv"), read_table(folder / "pulses.csv")
    rows: list[tuple[str, Callable[[], np.ndarray]]] = [
        ("published parameters", lambda: PUBLISHED),
        ("explain, on estimation", lambda: found(folder, estimation)),
        ("Coulomb and offset fitted to this measure on estimation", lambda: fitted(estimation, 4)),
        ("Coulomb and offset fitted to this measure on pulses itself", lambda: fitted(pulses, 4)),
        ("with direction-dependent viscous friction, on estimation", lambda: fitted(estimation, 5)),
    ]
    print(f"{'force error':60s} estimation  pulses")
    for name, make in rows:
        p = make()
        print(f"{name:60s} {100 * error(p, estimation):8.2f} %  {100 * error(p, pulses):6.2f} %")


if __name__ == "__main__":
    main()
