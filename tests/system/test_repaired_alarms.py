"""A lag the model leaves out raises alarms; detectors on the improved model keep the rate they promise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from afdsvc.api.model import Model, Variable
from afdsvc.app.diagnose import diagnose_recordings
from afdsvc.app.explain import ExplainOptions, explain_files
from afdsvc.files.model.model_file import read_model, write_model
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace

DT, PERIOD, SD, WINDOW, RATE = 2e-3, 500, 0.02, 50, 0.01


def spring() -> Model:
    plant = StateSpace(np.array([[0, 1.0], [-1e4, -40]]), np.array([[0.0], [1e4]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
    states = (Variable("q", "mm"), Variable("v", "mm/s", rate_of="q"))
    return Model("spring", (Variable("force", "N"),), (Variable("position", "mm"),), states, plant, output_sd=np.array([SD]))


def truth() -> StateSpace:
    """The spring behind an actuator of 3 ms, 1 % softer than stated, sampled exactly."""
    A = np.array([[0, 1.0, 0], [-0.99e4, -40, 1e4], [0, 0, -1 / 3e-3]])
    return sample_zoh(StateSpace(A, np.array([[0.0], [0], [1 / 3e-3]]), np.array([[1.0, 0, 0]]), np.zeros((1, 1))), DT)


def record(path: Path, level: float, seed: int, periods: int) -> Path:
    rng = np.random.default_rng(seed)
    lines = np.array([k for i, k in enumerate(range(1, 60, 2)) if i % 4 != 3])
    t = np.arange(PERIOD) * DT
    u = np.cos(2 * np.pi * np.outer(t, lines) + rng.uniform(0, 2 * np.pi, len(lines))).sum(1)
    u = np.tile(level * u / u.std(), periods)
    y = simulate(truth(), u[:, None])[0][:, 0] + SD * rng.standard_normal(len(u))
    np.savez(path, t=np.arange(len(u)) * DT, u_force=u, y_position=y)
    return path


pytestmark = pytest.mark.long  # a search with the whole library before the first test


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> tuple[Path, Path, Path]:
    """Nominal model, improved model, and a long recording neither was fitted to."""
    folder = tmp_path_factory.mktemp("lag")
    nominal = folder / "spring.toml"
    write_model(spring(), nominal)
    tables = [record(folder / f"r{k}.npz", level, k, 5) for k, level in enumerate((1.0, 0.5, 0.75))]
    document = explain_files(nominal, tables, [record(folder / "held.npz", 0.8, 7, 5)], ExplainOptions(folder / "out", jobs=1))
    assert document["named"][0]["physics"] == "actuator_lag"
    return nominal, Path(document["model"]), record(folder / "long.npz", 0.9, 11, 40)


def alarm_rate(model: Path, table: Path) -> tuple[int, int]:
    """Return alarms and windows of the energy detector: the sum of squares of the residual over its noise, chi-square."""
    m, data = read_model(model), np.load(table)
    assert m.plant is not None
    r = (data["y_position"] - simulate(sample_zoh(m.plant, DT), data["u_force"][:, None])[0][:, 0])[PERIOD:] / SD
    energy = np.square(r[: len(r) // WINDOW * WINDOW]).reshape(-1, WINDOW).sum(1)
    return int((energy > stats.chi2.isf(RATE, WINDOW)).sum()), len(energy)


def test_the_promised_rate_is_kept_on_the_improved_model_and_not_on_the_nominal_one(files):
    nominal, improved, long = files
    wrong, windows = alarm_rate(nominal, long)
    right, _ = alarm_rate(improved, long)
    assert windows == 390
    assert wrong > 0.5 * windows
    low, high = stats.binom.ppf([0.0005, 0.9995], windows, RATE)
    assert low <= right <= high


def test_the_detectors_of_the_service_trust_the_improved_model_as_it_is(files):
    nominal, improved, long = files
    before, after = (diagnose_recordings([long], m)["recordings"][0] for m in (nominal, improved))
    assert not before["verdict"]["trustworthy"]
    assert "not white" in before["verdict"]["reason"]
    assert after["verdict"]["trustworthy"]
    assert not any(d["detected"] for d in after["passive"])
