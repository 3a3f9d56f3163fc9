"""Exports of historians: one value a row, tags at times of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from afdsvc.app.init import init_files
from afdsvc.errors import BadInput
from afdsvc.files.tables.foreign import prepared, read_foreign_columns
from afdsvc.files.tables.formats import read_columns
from afdsvc.files.tables.mapping import read_mapping

N = 400


@pytest.fixture
def export(tmp_path: Path) -> Path:
    """A voltage every 0.1 s and a speed every 0.1 s, half a sample later, rows in no order; one value is lost."""
    rng = np.random.default_rng(1)
    steps = np.repeat(rng.uniform(-5, 5, N // 10), 10)
    rows = [(1000 + 100 * k, "MOTOR.voltage_V", f"{steps[k]:.4f}") for k in range(N)]
    rows += [(1050 + 100 * k, "MOTOR.speed_rpm", f"{100 * steps[k]:.3f}") for k in range(N)]
    rows += [(1000 + 100 * N, "MOTOR.voltage_V", "Bad")]
    text = "".join(f"2026-11-21T10:{ms // 60000:02d}:{ms % 60000 / 1000:06.3f}Z,{tag},{value},good\n" for ms, tag, value in (rows[i] for i in rng.permutation(len(rows))))
    (tmp_path / "export.csv").write_text("Timestamp,TagName,Value,Quality\n" + text)
    return tmp_path / "export.csv"


def test_init_writes_a_mapping_by_which_tags_become_signals(export: Path):
    found = init_files(export)
    assert [c["signal"] for c in found["columns"]] == ["y_motor_speed", "u_motor_voltage"]
    (trace,) = read_foreign_columns(export, read_mapping(found["mapping"]))
    assert trace.dt == pytest.approx(0.1)
    assert found["fits"]["motor_speed"]["num"][0] == pytest.approx(100, rel=0.1)
    said = prepared([trace])
    assert "export.csv: the time of a value is column Timestamp, its tag column TagName" in said
    assert "export.csv: 1 of 801 values are not numbers and are left out" in said


def test_without_a_mapping_the_way_out_is_named(export: Path):
    with pytest.raises(BadInput, match=r"one value a row, each with its tag; expected a mapping file \(--mapping FILE\.toml\), which 'afdsvc init' writes"):
        read_columns(export)


def test_a_tag_that_is_not_there_is_named_with_those_that_are(export: Path, tmp_path: Path):
    (tmp_path / "m.toml").write_text('[signals]\nu_voltage = "MOTOR.volts"\n')
    with pytest.raises(BadInput, match=r"no tag 'MOTOR\.volts' to be mapped; it has MOTOR\.speed_rpm, MOTOR\.voltage_V"):
        read_foreign_columns(export, read_mapping(tmp_path / "m.toml"))


def test_values_stored_when_they_change_hold_until_the_next_one(tmp_path: Path):
    rng = np.random.default_rng(2)
    times = {"voltage_V": np.sort(rng.uniform(0, 30, 60)), "speed_rpm": np.sort(rng.uniform(0, 30, 200))}
    values = {tag: np.round(rng.standard_normal(len(t)), 4) for tag, t in times.items()}
    rows = [f"2026-11-21T10:00:{s:09.6f}Z,{tag},{v}" for tag, t in times.items() for s, v in zip(t, values[tag], strict=True)]
    (tmp_path / "export.csv").write_text("Timestamp,TagName,Value\n" + "\n".join(rows) + "\n")
    signals = '[signals]\nu_voltage = "voltage_V"\ny_speed = "speed_rpm"\n'
    (tmp_path / "even.toml").write_text(signals)
    with pytest.raises(BadInput, match=r"state \[resample\] dt = ... and hold = true"):
        read_foreign_columns(tmp_path / "export.csv", read_mapping(tmp_path / "even.toml"))
    (tmp_path / "held.toml").write_text(signals + "[resample]\ndt = 0.1\nhold = true\n")
    (trace,) = read_foreign_columns(tmp_path / "export.csv", read_mapping(tmp_path / "held.toml"))
    start = max(round(t[0], 6) for t in times.values())
    grid = start + 0.1 * np.arange(len(trace.values))
    for channel, tag in zip(trace.channels, ("voltage_V", "speed_rpm"), strict=True):
        assert channel.name == {"voltage_V": "u_voltage", "speed_rpm": "y_speed"}[tag]
        last = [max(k for k, s in enumerate(times[tag]) if round(s, 6) <= g + 1e-9) for g in grid]
        assert trace.values[:, trace.channels.index(channel)].tolist() == values[tag][last].tolist()
    assert "export.csv: a value holds until the next one; one sample every 0.1 s" in prepared([trace])
    assert grid[-1] <= max(t[-1] for t in times.values()) < grid[-1] + 0.1


def test_holding_needs_a_sample_time(tmp_path: Path):
    (tmp_path / "held.toml").write_text('[signals]\nu_v = "v"\n[resample]\nhold = true\n')
    with pytest.raises(BadInput, match="'hold' needs 'dt'"):
        read_mapping(tmp_path / "held.toml")
