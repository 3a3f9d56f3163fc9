"""A slide with dry friction that its model knows nothing of.

    python explain_friction.py                                                       # writes slide.toml and four recordings
    afdsvc explain slide.toml weak.csv strong.csv medium.csv --holdout kept.csv      # why is the model wrong?
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

SLIDE = """
name = "slide"
time = "continuous"
inputs = [{name = "force", unit = "N"}]
outputs = [{name = "position", unit = "mm"}]
states = [{name = "q", unit = "mm"}, {name = "v", unit = "mm/s", rate_of = "q"}]
A = [[0, 1], [-4000, -20]]
B = [[0], [500]]
C = [[1, 0]]
D = [[0]]
[uncertainty]
relative = 0.03
"""
DT, PERIOD = 2e-3, 1000


def acceleration(q: float, v: float, u: float) -> float:
    """The real slide: 2 % stiffer than stated, and 0.4 N of friction (here as an arctan, which `explain` does not use)."""
    return -4080 * q - 20 * v + 500 * (u - 0.4 * np.arctan(v) * 2 / np.pi)


def record(path: str, level: float, seed: int) -> Path:
    """Play four periods of a random-phase multisine of odd lines, one line in four left out, and write what was measured."""
    rng = np.random.default_rng(seed)
    lines = np.array([k for i, k in enumerate(range(1, 80, 2)) if i % 4 != 3])
    phase = 2 * np.pi * np.outer(np.arange(PERIOD) / PERIOD, lines) + rng.uniform(0, 2 * np.pi, len(lines))
    u = np.cos(phase).sum(1)
    u = np.tile(level * u / u.std(), 5)
    q = v = 0.0
    y = np.empty(len(u))
    for k, force in enumerate(u):
        y[k] = q
        for _ in range(20):
            v += DT / 20 * acceleration(q, v, force)
            q += DT / 20 * v
    y += 0.03 * rng.standard_normal(len(u))
    np.savetxt(path, np.column_stack([np.arange(len(u)) * DT, u, y]), delimiter=",", header="t,u_force,y_position", comments="")
    return Path(path)


if __name__ == "__main__":
    Path("slide.toml").write_text(SLIDE)
    for name, level, seed in (("weak", 2.0, 1), ("strong", 4.0, 2), ("medium", 3.0, 3), ("kept", 2.5, 4)):
        record(f"{name}.csv", level, seed)
    print("slide.toml, and weak.csv, strong.csv, medium.csv, kept.csv: a slide at four levels of force")
