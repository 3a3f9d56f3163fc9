"""What locating costs: 10 s at 5 kHz, two inputs and two outputs, against the 3 s it may take, in processor time.

    python benchmarks/explain/locate.py
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from afdsvc.dataset.experiment import prepare
from afdsvc.explain.baseline import baseline
from afdsvc.explain.forward import seen
from afdsvc.explain.locate import locate
from afdsvc.explain.nominal import nominal
from afdsvc.files.model.model_file import read_model
from afdsvc.trial import generate
from afdsvc.trial.model_text import model_text

LIMIT = 3.0  # s


def main() -> None:
    """Print seconds and the ratio to the limit."""
    trial = generate("coulomb_friction", "state:horizontal_rate", 0.3, np.random.default_rng(1))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.toml"
        path.write_text(model_text(trial.machine), encoding="utf-8")
        model = read_model(path)
    runs = prepare(model, (*trial.recordings, trial.holdout))
    base = baseline(nominal(model, runs[0].dt), runs[:2])
    sight = seen(base)
    locate(base, runs[2:], sight)  # what is compiled on first use
    start = time.process_time()
    locate(base, runs[2:], sight)
    took = time.process_time() - start
    print(f"{sum(len(r) for r in runs)} samples located in {took:.2f} s of processor time: {took / LIMIT:.2f} of the limit of {LIMIT:g} s")


if __name__ == "__main__":
    main()
