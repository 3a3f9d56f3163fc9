"""A motor's log as a data logger writes it: ISO times with a zone, volts, revolutions per minute. Dry friction is in it, and in no model.

    python motor_recording.py                               # writes motor.csv and kept.csv
    afdsvc init motor.csv                                   # writes MODEL.toml and mapping.toml
    afdsvc check MODEL.toml motor.csv --mapping mapping.toml
    afdsvc explain MODEL.toml motor.csv --mapping mapping.toml --holdout kept.csv
"""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np

DT, GAIN, TAU, FRICTION = 0.005, 115.0, 0.08, 0.8  # s, rpm/V, s, V
START = datetime(2026, 11, 21, 10, 0, tzinfo=timezone(timedelta(hours=1)))


def record(path: str, seed: int, levels: tuple[float, ...]) -> None:
    """Play random steps at several levels; write the voltage and the measured speed."""
    rng = np.random.default_rng(seed)
    volts = np.concatenate([np.repeat(rng.uniform(-level, level, 60), 40) for level in levels])
    speed, rows = 0.0, []
    for k, u in enumerate(volts):
        at = (START + timedelta(seconds=DT * k)).isoformat(timespec="milliseconds")
        rows.append(f"{at},{u:.4f},{speed + rng.normal(0, 1.5):.2f}")
        for _ in range(10):
            speed += DT / 10 / TAU * (GAIN * (u - FRICTION * np.tanh(speed / 5)) - speed)
    Path(path).write_text("timestamp,voltage_V,speed_rpm\n" + "\n".join(rows) + "\n")


if __name__ == "__main__":
    record("motor.csv", 1, (3.0, 8.0, 5.0))
    record("kept.csv", 2, (4.0, 7.0))
    print("motor.csv and kept.csv: a motor at three and at two levels of voltage")
