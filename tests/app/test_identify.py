"""Identify now: a broad burst within the limits, and the plant found again from the recording of a changed machine."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from afdsvc.api.signals import Trace
from afdsvc.app import pipelines, ports
from afdsvc.app.identify import identify_files
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import parse_model, read_model, write_model
from afdsvc.files.tables.tables import import_table
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.simulate import simulate
from afdsvc.service.clock import FastClock

EXAMPLES = Path(__file__).parents[2] / "examples"


def recorded(bearing, plugins, purpose: str, seed: int, faults: dict) -> tuple[np.ndarray, object]:
    """Return the samples of one identification burst on a machine with faults, and the machine."""
    machine = bearing("lqg", 0, seed, faults)
    port = ports.open_port(machine, "s", FastClock(), plugins)
    burst = pipelines.identification_burst(machine, purpose, np.random.default_rng(seed))
    port.check(burst, machine.limits)
    blocks = [port.read(), port.read()]
    with port.arm(machine.limits) as drive:
        drive.play(burst)
        while drive.playing:
            blocks.append(port.read())
        assert drive.aborted == ""
    values = np.vstack([b.values for b in blocks])
    assert np.abs(values[:, 2:4]).max() < 10.0
    return values, machine


@pytest.mark.parametrize("purpose", ["identify", "identify_binary", "identify_sweep"])
def test_bursts_fit_the_machine(bearing, plugins, purpose):
    values, _ = recorded(bearing, plugins, purpose, 3, {})
    assert np.abs(values[:, 2:4]).max() > 3.0  # half the room is really used


def test_an_unknown_purpose_is_named(bearing):
    with pytest.raises(BadInput, match="burst purpose 'x'; expected one of diagnose, identify"):
        pipelines.identification_burst(bearing(), "x", np.random.default_rng(0))


def test_a_changed_machine_is_identified_in_closed_loop(bearing, plugins, tmp_path):
    """The vertical actuator lost half its gain: the new model's response is that of the changed plant."""
    paths = []
    for seed in (1, 2):
        values, machine = recorded(bearing, plugins, "identify", seed, {"vertical_actuator": (-0.5, 0.0)})
        trace = Trace(f"run{seed}", machine.plant.dt, machine.channels, values)
        paths.append(import_table(trace, tmp_path / f"run{seed}.mcap", machine="bearing"))
    write_model(parse_model(machine.model_text(), "model.toml"), tmp_path / "model.toml")
    document = identify_files(tmp_path / "model.toml", paths[:1], paths[1:], tmp_path / "new.toml", {}, 0)
    json.dumps(document)
    assert document["method"] == "hansen"
    assert document["loop_stable"] is True
    fit = document["fit"]["per_output"]
    true = machine.augmented.close({"vertical_actuator": -0.5})
    # the noise hides most of this output: no model simulates it better than the true plant does
    u, y = values[:, :2], values[:, 2:4]
    left = (y - simulate(true, u)[0])[:, 1]
    ceiling = 1 - left.std() / y[:, 1].std()
    assert fit["vertical"]["before"]["r2"] < 0.1 < ceiling
    assert fit["vertical"]["after"]["r2"] > ceiling - 0.01
    omega = np.array([200.0, 1000.0, 1350.0])
    found = frequency_response(read_model(tmp_path / "new.toml").plant, omega)[:, [0, 1], [0, 1]]
    wanted = frequency_response(true, omega)[:, [0, 1], [0, 1]]
    assert np.abs(np.abs(found / wanted) - 1).max() < 0.1


def test_the_slide_of_the_tutorial_is_identified(tmp_path, monkeypatch):
    """PBSIDopt finds an unstable plant on these lines; what cannot have run in open loop must not be run."""
    example = runpy.run_path(str(EXAMPLES / "explain_friction.py"))
    monkeypatch.chdir(tmp_path)
    Path("slide.toml").write_text(example["SLIDE"])
    weak, medium, kept = (example["record"](f"{name}.csv", level, seed) for name, level, seed in (("weak", 2.0, 1), ("medium", 3.0, 3), ("kept", 2.5, 4)))
    document = identify_files(Path("slide.toml"), [weak, medium], [kept], None, {}, 0)
    fit = document["fit"]["per_output"]["position"]
    assert fit["after"]["r2"] > 0.85 > 0.7 > fit["before"]["r2"]
    assert "PBSIDopt finds on these recordings is unstable" in json.dumps(document)


def test_an_interruption_between_the_page_and_the_model_leaves_neither(tmp_path, monkeypatch):
    rng = np.random.default_rng(1)
    (tmp_path / "model.toml").write_text('name = "m"\ntime = "discrete"\nsample_time = 0.1\ninputs = [{name = "u"}]\noutputs = [{name = "y"}]\nA = [[0.9]]\nB = [[1.0]]\nC = [[1.0]]\n')
    u = rng.standard_normal(600)
    y = np.convolve(u, 0.8 ** np.arange(60))[:600] + 0.1 * rng.standard_normal(600)
    np.savetxt(tmp_path / "run.csv", np.column_stack([0.1 * np.arange(600), u, y]), delimiter=",", header="t,u_u,y_y", comments="")

    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr("afdsvc.app.identify.write_model", interrupted)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(KeyboardInterrupt):
        identify_files(tmp_path / "model.toml", [tmp_path / "run.csv"], [], tmp_path / "new.toml", {"groups": 0}, 0)
    assert sorted(tmp_path.iterdir()) == before


def _motor(folder, speed) -> Path:
    """Write a model and a table of a motor's voltage and ``speed (3000,)``; an element that is no number becomes an empty cell."""
    voltage = np.random.default_rng(0).standard_normal(3000)
    rows = [f"{0.01 * k:.2f},{u:.6f},{'' if np.isnan(y) else f'{y:.6f}'}" for k, (u, y) in enumerate(zip(voltage, speed(voltage), strict=True))]
    (folder / "motor.csv").write_text("\n".join(["t,voltage,speed", *rows]), encoding="utf-8")
    (folder / "MODEL.toml").write_text(
        'name = "motor"\ntime = "continuous"\ninputs = [{name = "voltage", unit = "V"}]\noutputs = [{name = "speed", unit = "rad/s"}]\nnum = [2]\nden = [0.1, 1]\n',
        encoding="utf-8",
    )
    return folder / "MODEL.toml"


def test_an_output_that_never_moves_is_said_to_be_so(tmp_path):
    model = _motor(tmp_path, lambda u: np.full(len(u), 0.37))
    with pytest.raises(BadInput, match=r"output 'speed' reads 0.37 rad/s in every sample; expected recordings in which it moves"):
        identify_files(model, [tmp_path / "motor.csv"], [], None, {}, 0)


def test_empty_cells_of_a_table_are_missing_samples(tmp_path):
    def speed(u):
        y = lfilter([0, 0.2], [1, -0.9], u) + 0.01 * np.random.default_rng(1).standard_normal(len(u))
        y[1200:1203] = np.nan
        return y

    found = identify_files(_motor(tmp_path, speed), [tmp_path / "motor.csv"], [], None, {}, 0)
    assert "motor.csv: samples are missing; fitted 2 stretches without gaps, 2997 of 3000 samples" in found["warnings"]
