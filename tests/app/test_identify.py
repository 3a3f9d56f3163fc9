"""Identify now: a broad burst within the limits, and the plant found again from the recording of a changed machine."""

from __future__ import annotations

import json

import numpy as np
import pytest

from afdsvc.api.signals import Trace
from afdsvc.app import commissioning
from afdsvc.app.identify import identify_files
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import parse_model, read_model, write_model
from afdsvc.files.tables.to_recording import import_table
from afdsvc.lti.frequency import frequency_response
from afdsvc.service.clock import FastClock


def recorded(bearing, plugins, purpose: str, seed: int, faults: dict) -> tuple[np.ndarray, object]:
    """Return the samples of one identification burst on a machine with faults, and the machine."""
    machine = bearing("lqg", 0, seed, faults)
    port = commissioning.open_port(machine, "s", FastClock(), plugins)
    burst = commissioning.identification_burst(machine, purpose, np.random.default_rng(seed))
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
        commissioning.identification_burst(bearing(), "x", np.random.default_rng(0))


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
    # the noise hides most of this output: simulating the true plant itself gives about 0.19
    assert fit["vertical"]["after"]["r2"] > fit["vertical"]["before"]["r2"] + 0.15
    true = machine.augmented.close({"vertical_actuator": -0.5})
    omega = np.array([200.0, 1000.0, 1350.0])
    found = frequency_response(read_model(tmp_path / "new.toml").plant, omega)[:, [0, 1], [0, 1]]
    wanted = frequency_response(true, omega)[:, [0, 1], [0, 1]]
    assert np.abs(np.abs(found / wanted) - 1).max() < 0.1
