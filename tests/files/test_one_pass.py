"""Every command that judges recordings opens each of them once and reads it once through; opens and bytes are counted below it."""

from __future__ import annotations

import io
import shutil
from pathlib import Path

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.app.diagnose import diagnose_recordings
from afdsvc.app.explain import ExplainOptions, explain_files
from afdsvc.app.identify import identify_files
from afdsvc.files.model.model_file import write_model
from afdsvc.files.tables.tables import import_traces
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace

SHIPPED = Path(__file__).parents[2] / "recordings" / "shipped" / "gas_bearing_horizontal_sensor.mcap"
AGAIN = 1.15  # of the bytes of the file: the headers of all chunks are read before the chunks, a buffer at a time


class Counter:
    """Opens and bytes of every recording, by name."""

    def __init__(self) -> None:
        self.opens: dict[str, int] = {}
        self.bytes: dict[str, int] = {}

    def open(self, path: Path) -> io.BufferedReader:
        counter = self

        class Counting(io.FileIO):
            def readinto(self, buffer) -> int | None:
                n = super().readinto(buffer)
                counter.bytes[path.name] = counter.bytes.get(path.name, 0) + (n or 0)
                return n

            def readall(self) -> bytes:
                data = super().readall()
                counter.bytes[path.name] = counter.bytes.get(path.name, 0) + len(data)
                return data

        self.opens[path.name] = self.opens.get(path.name, 0) + 1
        return io.BufferedReader(Counting(path))


@pytest.fixture
def counted(monkeypatch) -> Counter:
    """The real files, through a reader that counts."""
    counter, usual = Counter(), Path.open

    def opening(path: Path, mode: str = "r", *rest, **named):
        return counter.open(path) if path.suffix == ".mcap" and mode == "rb" else usual(path, mode, *rest, **named)

    monkeypatch.setattr(Path, "open", opening)
    return counter


@pytest.fixture(scope="module")
def lag(tmp_path_factory) -> tuple[Path, list[Path]]:
    """A model, and three imported recordings of it that carry the model."""
    folder, rng = tmp_path_factory.mktemp("lag"), np.random.default_rng(0)
    plant = StateSpace(np.array([[0.9]]), np.array([[0.1]]), np.array([[1.0]]), np.zeros((1, 1)), 0.005)
    model = Model("lag", (Variable("force", "N"),), (Variable("position", "mm"),), (Variable("v", "mm"),), plant)
    write_model(model, folder / "lag.toml")
    channels, found = (Channel("u_force", "N"), Channel("y_position", "mm")), []
    for k in range(3):
        u = rng.standard_normal((6000, 1))
        y = simulate(plant, u)[0] + 0.01 * rng.standard_normal(u.shape)
        trace = Trace(f"r{k}", 0.005, channels, np.hstack([u, y]))
        found.append(import_traces([trace], folder / f"r{k}.mcap", model, "lag"))
    return folder / "lag.toml", found


def holds(counted: Counter, paths: list[Path]) -> None:
    assert counted.opens == {p.name: 1 for p in paths}
    for path in paths:
        size = path.stat().st_size
        assert 0.99 * size < counted.bytes[path.name] < AGAIN * size + 2 * io.DEFAULT_BUFFER_SIZE


def test_diagnose_of_a_recording_of_the_service(counted, tmp_path):
    path = Path(shutil.copy(SHIPPED, tmp_path))
    assert diagnose_recordings([path])["recordings"][0]["verdict"]["fault"] == "horizontal_sensor"
    holds(counted, [path])


def test_diagnose_of_imported_recordings(counted, lag):
    assert len(diagnose_recordings(lag[1])["recordings"]) == 3
    holds(counted, lag[1])


def test_identify(counted, lag, tmp_path):
    identify_files(lag[0], lag[1][:2], lag[1][2:], tmp_path / "new.toml", {}, 0)
    holds(counted, lag[1])


def test_explain(counted, lag, tmp_path):
    explain_files(lag[0], lag[1][:2], lag[1][2:], ExplainOptions(tmp_path, jobs=1))
    holds(counted, lag[1])


def test_explain_of_a_recording_by_its_own_model(counted, lag, tmp_path):
    explain_files(lag[1][0], [], lag[1][2:], ExplainOptions(tmp_path, jobs=1))
    holds(counted, [lag[1][0], lag[1][2]])
