"""A trial on disk is complete, readable by the product, silent about its answer, and cannot be changed afterwards."""

from __future__ import annotations

import json

import numpy as np
import pytest

from afdsvc.errors import BadInput, Refused
from afdsvc.files.model.model_file import read_model
from afdsvc.files.tables.formats import read_columns
from afdsvc.trial import Options, generate_trial, open_seal, seal, write

SHORT = Options(controller="lqg", periods=1)


@pytest.fixture(scope="module")
def trial():
    return generate_trial("coulomb_friction", "state:vertical_rate", 0.3, np.random.default_rng(8), SHORT)


def test_model_file_is_the_nominal_model_and_not_the_truth(trial, tmp_path) -> None:
    model = read_model(write(trial, tmp_path / "t").model)
    A, B, C = trial.machine.matrices(trial.machine.nominal)
    assert np.array_equal(model.plant.A, A)
    assert np.array_equal(model.plant.B, B)
    assert np.array_equal(model.plant.C, C)
    assert not np.allclose(A, trial.machine.matrices(trial.truth.theta)[0], rtol=1e-3)
    assert np.array_equal(model.controller.A, trial.machine.controller.A)
    assert model.controller.dt == trial.machine.dt
    assert model.output_sd == pytest.approx(np.sqrt([0.12, 0.15]))
    assert [s.rate_of for s in model.states[2:4]] == ["horizontal", "vertical"]


def test_stated_uncertainty_covers_the_truth(trial, tmp_path) -> None:
    model = read_model(write(trial, tmp_path / "t").model)
    for name, true in zip("ABC", trial.machine.matrices(trial.truth.theta), strict=True):
        apart, sd = np.abs(true - getattr(model.plant, name)), model.entry_sd[name]
        assert (apart <= 2.0001 * sd).all(), name
        assert (apart > 0).any(), name


@pytest.mark.parametrize("form", ["npz", "csv"])
def test_tables_have_the_fixed_columns_and_the_numbers(trial, tmp_path, form) -> None:
    paths = write(trial, tmp_path / "t", form)
    assert [p.name for p in paths.all] == ["MODEL.toml", *(f"recording_{i}.{form}" for i in (1, 2, 3)), f"holdout.{form}"]
    columns = read_columns(paths.recordings[1])
    expected = ["t"] + [f"{role}_{axis}" for role in ("u", "y", "alpha") for axis in ("horizontal", "vertical")]
    assert list(columns) == expected + ["aux_speed", "aux_angle", "aux_pressure", "aux_temperature"]
    assert columns["y_vertical"] == pytest.approx(trial.recordings[1].column("y_vertical"), rel=1e-11)
    assert np.diff(columns["t"]) == pytest.approx(2e-4, rel=1e-6)
    assert columns["aux_angle"].max() < 2 * np.pi


def test_axis_records_its_reference_and_hides_its_controller_when_asked(tmp_path) -> None:
    options = Options(machine="positioning_axis", periods=1, known_controller=False)
    paths = write(generate_trial("nothing", None, 0.0, np.random.default_rng(1), options), tmp_path / "a")
    assert "ref_position" in read_columns(paths.holdout)
    assert read_model(paths.model).controller is None


def test_recordings_differ_in_level_speed_and_phases(trial) -> None:
    first, second, third = trial.recordings
    ratio = second.role("alpha").std(axis=0) / first.role("alpha").std(axis=0)
    assert ratio == pytest.approx([2, 2], rel=0.25)
    speeds = [t.column("aux_speed").mean() for t in (first, second, third, trial.holdout)]
    assert len({round(s) for s in speeds}) == 4
    assert abs(np.corrcoef(first.role("alpha")[:, 0], second.role("alpha")[:, 0])[0, 1]) < 0.2


def test_excitation_is_odd_interleaved_and_leaves_detection_lines() -> None:
    trial = generate_trial("nothing", None, 0.0, np.random.default_rng(9), Options(controller="proportional", periods=1))
    lines = np.abs(np.fft.rfft(trial.recordings[0].role("alpha"), axis=0)) > 1.0
    first, second = (set(np.flatnonzero(lines[:, i])) for i in range(2))
    assert not first & second
    odd = set(range(1, 301, 2))
    assert first | second <= odd
    assert len(odd - first - second) == pytest.approx(len(odd) / 4, abs=2)


def test_same_generator_same_bits_and_another_differs() -> None:
    a, b, c = (generate_trial("dead_zone", None, 0.2, np.random.default_rng(s), SHORT) for s in (5, 5, 6))
    assert np.array_equal(a.recordings[0].values, b.recordings[0].values)
    assert a.answer == b.answer
    assert not np.array_equal(a.recordings[0].values, c.recordings[0].values)


def test_folder_does_not_tell(trial, tmp_path) -> None:
    paths = write(trial, tmp_path / "t")
    seal(trial.answer, paths, tmp_path / "vault")
    words = ["coulomb", "friction", "vertical_rate\"}, rho", trial.answer.seed or "8/0"]
    for path in (tmp_path / "t").iterdir():
        content = path.read_bytes().lower()
        assert not any(word.encode() in content for word in words[:2]), path
    assert set(json.loads((tmp_path / "t" / "SEAL.json").read_text())) == {"algorithm", "commitment"}


def test_commitment_cannot_be_guessed_from_the_answer(trial, tmp_path) -> None:
    digests = set()
    for name in ("a", "b"):
        seal(trial.answer, write(trial, tmp_path / name), tmp_path / "vault")
        digests.add((tmp_path / name / "SEAL.json").read_text())
    assert len(digests) == 2  # the nonce


def test_opening_returns_the_answer(trial, tmp_path) -> None:
    kept = seal(trial.answer, write(trial, tmp_path / "t"), tmp_path / "vault")
    assert open_seal(tmp_path / "t", kept) == trial.answer


def test_changed_answers_and_recordings_are_refused(trial, tmp_path) -> None:
    paths = write(trial, tmp_path / "t")
    kept = seal(trial.answer, paths, tmp_path / "vault")
    text = kept.read_text()
    kept.write_text(text.replace("coulomb_friction", "dead_zone"))
    with pytest.raises(Refused, match="not the answer"):
        open_seal(tmp_path / "t", kept)
    kept.write_text(text)
    paths.holdout.write_bytes(paths.holdout.read_bytes() + b"x")
    with pytest.raises(Refused, match="not the file"):
        open_seal(tmp_path / "t", kept)


def test_bad_places_are_refused(trial, tmp_path) -> None:
    paths = write(trial, tmp_path / "t")
    with pytest.raises(BadInput, match="there already"):
        write(trial, tmp_path / "t")
    with pytest.raises(BadInput, match="inside the trial's folder"):
        seal(trial.answer, paths, tmp_path / "t" / "vault")
    with pytest.raises(BadInput, match="npz or csv"):
        write(trial, tmp_path / "u", "xls")
    with pytest.raises(BadInput, match="cannot be read as a seal"):
        open_seal(tmp_path / "t", tmp_path / "none.json")
