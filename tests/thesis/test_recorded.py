"""Figures of the thesis from recordings of the service."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from afdsvc.errors import BadInput
from benchmarks.thesis.__main__ import figures, main
from benchmarks.thesis.machines import bearing, detect_in, residuals, sine
from benchmarks.thesis.recorded import EXPERIMENTS, Measured, record

RECORDED = [f for f in figures() if f.recorded]
SHIPPED = Path(__file__).parents[2] / "recordings" / "shipped"


@pytest.mark.long
@pytest.mark.parametrize("name", EXPERIMENTS)
def test_figures_from_a_recording_of_the_service(name, tmp_path, capsys):
    path = record(name, tmp_path)
    made = [f for f in RECORDED if f.experiment == name]
    assert made
    for figure in made:
        rows = figure.recorded(Measured.of(path, name))
        assert [(r.what, r.ours) for r in rows if not r.holds] == []
        assert main([figure.name, str(path)]) == 0
        assert figure.shows in capsys.readouterr().out


def test_what_is_read_from_a_recording():
    measured = Measured.of(SHIPPED / "gas_bearing_vertical_sensor.mcap", "lqg", 0.0)
    beta, r = measured.healthy(bearing("lqg"))
    assert beta.shape == r.shape == (measured.begin - 2500, 2)
    assert measured.begin < measured.end < len(measured.y)
    assert np.abs(measured.alpha[: measured.begin]).max() == 0.0
    assert np.abs(measured.alpha[measured.begin : measured.end]).max() > 0.0
    assert r.var(axis=0) == pytest.approx([0.12, 0.15], rel=0.1)


def test_the_detector_sees_the_same_in_a_piece_of_a_run():
    loop, n = bearing(), 6000
    _, r = residuals(loop, "horizontal_actuator", -0.5, 4000, sine(loop, 62.0, 2.26, 0, n))
    found = detect_in(r, loop, "horizontal_actuator", 62.0, 2.26, 0, 0, 1000, 500, 4000)
    assert (found.before, found.after) == (0.0, 1.0)


def test_what_is_missing_is_one_sentence(tmp_path, capsys):
    with pytest.raises(BadInput):
        Measured.of(tmp_path / "none.mcap", "rest")
    assert main(["p5-0.13", "x.mcap"]) == 2
    assert "not made from a recording" in capsys.readouterr().out
