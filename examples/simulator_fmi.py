"""An FMI unit as the nominal simulation: record the real slide, ask `explain` what the unit leaves out.

    python simulator_fmi.py        # builds Slide2.fmu with pythonfmu, writes slide.toml and four recordings, explains them
    afdsvc explain slide.toml weak.csv strong.csv medium.csv --holdout kept.csv --allow-code     # the same on the command line

Needs the extra: pip install "afdsvc[fmi]" pythonfmu
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np

from afdsvc.app.explain import ExplainOptions, explain_files
from afdsvc.testing.fmi_units import build_slide

MODEL = """
name = "slide"
time = "discrete"
sample_time = 0.002
inputs = [{name = "force", unit = "N"}]
outputs = [{name = "position", unit = "mm"}]
states = [{name = "position", unit = "mm"}, {name = "velocity", unit = "mm/s", rate_of = "position"}]
dynamics = "Slide2.fmu"
[parameters]
stiffness = {value = 4000.0}
[uncertainty]
relative = 0.03
"""
DT, PERIOD = 2e-3, 1000


def record(path: str, level: float, seed: int) -> Path:
    """Play a random-phase multisine to the real slide: 2 % stiffer than the unit, and with 0.4 N of dry friction."""
    rng = np.random.default_rng(seed)
    lines = np.array([k for i, k in enumerate(range(1, 80, 2)) if i % 4 != 3])
    phase = 2 * np.pi * np.outer(np.arange(PERIOD) / PERIOD, lines) + rng.uniform(0, 2 * np.pi, len(lines))
    u = np.cos(phase).sum(1)
    u = np.tile(level * u / u.std(), 5)
    q, v, y = 0.0, 0.0, np.empty(len(u))
    for k, force in enumerate(u):
        y[k] = q
        for _ in range(20):
            v += DT / 20 * (-4080 * q - 20 * v + 500 * (force - 0.4 * np.arctan(v) * 2 / np.pi))
            q += DT / 20 * v
    y += 0.03 * rng.standard_normal(len(u))
    np.savetxt(path, np.column_stack([np.arange(len(u)) * DT, u, y]), delimiter=",", header="t,u_force,y_position", comments="")
    return Path(path)


def main() -> None:
    """Build the unit, record, explain."""
    if not (find_spec("fmpy") and find_spec("pythonfmu")):
        print("this example needs afdsvc[fmi] and pythonfmu")
        return
    build_slide(Path())
    Path("slide.toml").write_text(MODEL)
    fit = [record("weak.csv", 2.0, 1), record("strong.csv", 4.0, 2), record("medium.csv", 3.0, 3)]
    held = record("kept.csv", 2.5, 4)
    answer = explain_files(Path("slide.toml"), fit, [held], ExplainOptions(Path("slide.explained"), allow_code=True))
    for sentence in answer["check"][:6]:
        print("note:", sentence)
    print("verdict:", answer["verdict"])
    for named in answer["named"]:
        print(f"{named['weight']:.2f}", named["sentence"])


if __name__ == "__main__":
    main()
