"""Which trials are asked for; that they run on files alone; and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from afdsvc.app import trial
from afdsvc.app.trial import study_requests, trial_files
from afdsvc.cli import app
from afdsvc.errors import BadInput
from afdsvc.trial.study import field_plan, plan


def test_a_plain_plan_is_the_plan() -> None:
    assert study_requests(30, 3, None, (), ()) == plan(30, 3)


def test_kinds_and_parts_and_severity_are_as_asked() -> None:
    some = study_requests(6, 3, 0.7, ("dead_zone", "backlash"), ("bearing",))
    assert len(some) == 6
    assert {r.part for r in some} == {"bearing"}
    assert {w.physics for r in some for w in r.wishes} == {"dead_zone", "backlash"}
    assert {w.rho for r in some for w in r.wishes} == {0.7}
    assert all(not r.wishes for r in study_requests(3, 1, None, ("nothing",), ()))
    assert len({r.number for r in some}) == 6


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((0, 1, None, (), ()), ["--n 0"]),
        ((5, 1, -1.0, (), ()), ["--rho -1"]),
        ((5, 1, None, ("phlogiston",), ()), ["phlogiston", "coulomb_friction"]),
        ((5, 1, None, (), ("sundays",)), ["sundays", "bearing"]),
        ((5, 1, None, ("dead_zone",), ("nothing",)), ["--kinds", "--parts"]),
    ],
)
def test_what_cannot_be_asked_is_one_sentence(arguments, words) -> None:
    with pytest.raises(BadInput) as refusal:
        study_requests(*arguments)
    assert all(word in str(refusal.value) for word in words)


def test_parts_and_kinds_may_be_given_with_commas_or_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[list[str], list[str]]] = []

    def stopped(folder: Path, n: int, seed: int, rho: float | None, kinds: list[str], parts: list[str], *rest: object) -> dict:
        asked.append((kinds, parts))
        raise BadInput("enough is known")

    monkeypatch.setattr(trial, "trial_files", stopped)
    for given in (["--parts", "axis,two", "--kinds", "backlash"], ["--parts", "axis", "--kinds", "backlash", "--parts", "two"], []):
        assert CliRunner().invoke(app, ["trial", "--folder", str(tmp_path), *given]).exit_code
    assert asked == [(["backlash"], ["axis", "two"])] * 2 + [([], [])]


def test_trials_are_made_sealed_explained_scored_and_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def silent(model: Path, recordings, holdout: Path) -> dict:
        seen.append(model.parent)
        assert sorted(p.name for p in model.parent.iterdir())[:2] == ["MODEL.toml", "SEAL.json"]
        return {"verdict": "consistent", "named": [], "located": []}

    monkeypatch.setattr(trial, "from_files", silent)
    reported: list[tuple[int, int]] = []
    made = trial_files(tmp_path, 1, 2, kinds=("nothing",), progress=lambda done, of: reported.append((done, of)))
    assert made["trials"] == len(seen) == 1
    assert reported == [(1, 1)]
    assert "1 with nothing hidden, of which 0 were given a name" in made["summary"]
    assert Path(made["markdown"]).read_text().startswith("# Blind trials")
    assert "<table" in Path(made["html"]).read_text()
    json.dumps(made)
    again = trial_files(tmp_path, 1, 2, kinds=("nothing",))
    assert len(seen) == 1
    assert again["summary"] == made["summary"]


def test_field_trials_are_a_part_of_their_own_and_may_only_be_written(tmp_path: Path) -> None:
    assert study_requests(5, 3, None, (), ("field",)) == field_plan(5, 3)
    both = study_requests(40, 3, None, ("dead_zone",), ("field", "bearing"))
    assert {r.part for r in both} == {"field", "bearing"}
    assert len({r.number for r in both}) == len(both)
    said = CliRunner().invoke(app, ["trial", "--folder", str(tmp_path), "--parts", "field", "--kinds", "nothing", "--n", "1", "--write-only", "--json"])
    assert said.exit_code == 0
    assert json.loads(said.stdout)["trials"] == 1
    assert len(list((tmp_path / "sealed").iterdir())) == 1
    assert not list((tmp_path / "results").iterdir())
