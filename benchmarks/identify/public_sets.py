"""Public data sets: columns, split and measure (mean over outputs of 1 - |y - yhat| / |y - mean|, in per cent)."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

#: First samples used for estimation; the rest is held out.
SHARE = 0.6

#: File, input columns, output columns (DaISy: De Moor et al., Journal A 38(3), 1997; cascaded tanks: Schoukens and Noel, 2017).
DAISY = {
    "CD player arm": ("CD_player_arm.dat", (0, 1), (2, 3)),
    "ball and beam": ("ballbeam.dat", (0,), (1,)),
    "flutter": ("flutter.dat", (0,), (1,)),
    "steam generator": ("steamgen.dat", (1, 2, 3, 4), (5, 6, 7, 8)),
    "winding": ("winding.dat", (0, 1, 2, 3, 4), (5, 6)),
    "CSTR": ("cstr.dat", (1,), (2, 3)),
    "evaporator": ("evaporator.dat", (0, 1, 2), (3, 4, 5)),
    "glass furnace": ("glassfurnace.dat", (1, 2, 3), (4, 5, 6, 7, 8, 9)),
    "thermic wall": ("thermic_res_wall.dat", (0, 1), (2,)),
    "pH": ("pHdata.dat", (1, 2), (3,)),
}


@dataclass(frozen=True)
class PublicSet:
    """Inputs and outputs for estimation and held out, ``(N, m)`` and ``(N, p)``, scaled by the estimation part's mean and deviation."""

    u: np.ndarray
    y: np.ndarray
    u_held: np.ndarray
    y_held: np.ndarray

    @classmethod
    def of(cls, u: np.ndarray, y: np.ndarray, u_held: np.ndarray, y_held: np.ndarray) -> PublicSet:
        def scaled(part: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            mean, deviation = part.mean(axis=0), part.std(axis=0)
            return (part - mean) / deviation, (other - mean) / deviation

        (a, b), (c, d) = scaled(u, u_held), scaled(y, y_held)
        return cls(a, c, b, d)


def public_sets(folder: Path) -> dict[str, Callable[[], PublicSet]]:
    """Return the sets by name; each is read when called."""
    found: dict[str, Callable[[], PublicSet]] = {}
    for name, (file, inputs, outputs) in DAISY.items():
        found[name] = lambda f=file, i=inputs, o=outputs: _daisy(folder / "daisy" / f, i, o)
    found["cascaded tanks"] = lambda: _tanks(folder / "daisy" / "cascaded_tanks.csv")
    found["Silverbox"] = lambda: _pair(folder / "silverbox" / "multisine.csv", folder / "silverbox" / "arrow.csv")
    found["two-mass A"] = lambda: _pair(folder / "two_mass" / "multisine_A.csv", None)
    found["two-mass B"] = lambda: _pair(folder / "two_mass" / "multisine_B.csv", None)
    return found


def from_environment() -> dict[str, Callable[[], PublicSet]]:
    """Return the sets of the folder that AFDSVC_DATA names."""
    return public_sets(Path(os.environ["AFDSVC_DATA"]))


def fit(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, data: PublicSet) -> float:
    """Return the fit of a discrete model on the held-out part in per cent, with the initial state fitted by least squares."""
    u, y = data.u_held, data.y_held
    x, forced = np.zeros(len(A)), np.empty_like(y)
    row, free = C, np.empty((*y.shape, len(A)))
    with np.errstate(all="ignore"):
        for k in range(len(y)):
            forced[k], free[k] = C @ x + D @ u[k], row
            x, row = A @ x + B @ u[k], row @ A
        left = y - forced
        if not (np.isfinite(left).all() and np.isfinite(free).all()):
            return -np.inf
        x0 = np.linalg.lstsq(free.reshape(-1, len(A)), left.ravel(), rcond=1e-10)[0] if len(A) else np.zeros(0)
        left = left - free @ x0
        return float(100 * np.mean(1 - np.linalg.norm(left, axis=0) / np.linalg.norm(y - y.mean(axis=0), axis=0)))


def _split(u: np.ndarray, y: np.ndarray) -> PublicSet:
    cut = int(SHARE * len(u))
    return PublicSet.of(u[:cut], y[:cut], u[cut:], y[cut:])


def _daisy(path: Path, inputs: tuple[int, ...], outputs: tuple[int, ...]) -> PublicSet:
    table = np.loadtxt(path)
    return _split(table[:, inputs], table[:, outputs])


def _tanks(path: Path) -> PublicSet:
    with path.open(newline="") as file:
        rows = [r[:4] for r in csv.reader(file) if len(r) >= 4]
    table = np.array([[float(v) for v in r] for r in rows[1:]])
    return PublicSet.of(table[:, :1], table[:, 2:3], table[:, 1:2], table[:, 3:4])


def _pair(path: Path, held: Path | None) -> PublicSet:
    def sides(file: Path) -> tuple[np.ndarray, np.ndarray]:
        with file.open() as lines:
            names = next(lines).strip().split(",")
        table = np.loadtxt(file, delimiter=",", skiprows=1)
        return tuple(table[:, [k for k, n in enumerate(names) if n.startswith(role)]] for role in ("u_", "y_"))  # type: ignore[return-value]

    return _split(*sides(path)) if held is None else PublicSet.of(*sides(path), *sides(held))
