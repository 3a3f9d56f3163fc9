"""A study of field trials: run, reported, or only written down for another engine to be judged by."""

from __future__ import annotations

import json

import pytest

from afdsvc.trial import FIELD, FieldAnswer, FieldOptions, Request, TrialRequest, markdown, open_seal, page, study, write_only
from afdsvc.trial.study import rescored

REQUESTS = [
    Request(0, FIELD, (TrialRequest("static_nonlinearity", None, 0.5),), FieldOptions("coil", ("lame",)), (9, 0)),
    Request(1, FIELD, (), FieldOptions("coil"), (9, 1)),
]


def explain(model, recordings, holdout) -> dict:
    assert sorted({p.suffix for p in model.parent.iterdir()}) == [".csv", ".json", ".toml"]
    fit = {"per_output": {"current": {"before": {"nrmse": 0.4}, "after": {"nrmse": 0.3}}}}
    return {"verdict": "omitted_physics", "named": [{"physics": "static_nonlinearity", "weight": 0.99, "share": 0.5}], "fit": fit}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    return folder, study(REQUESTS, explain, folder)


def test_study_scores_and_reports_field_trials(finished) -> None:
    _, (hidden, nothing) = finished
    assert hidden["score"]["outcome"] == "first"
    assert hidden["score"]["held_share"] > 0
    assert nothing["score"]["confident_false"]
    text = markdown(finished[1])
    assert "## Field trials" in text
    assert "| one | 1 of 1" in text
    assert "| nothing | 0 of 1" in text
    assert "By severity" not in text
    assert "Confusion matrix" not in page(finished[1])


def test_kept_results_can_be_scored_anew(finished) -> None:
    kept = json.loads((finished[0] / "results" / "0000.json").read_text())
    assert rescored(kept)["score"] == kept["score"]


def test_written_trials_are_sealed_and_judged_later(finished, tmp_path) -> None:
    places = write_only(REQUESTS, tmp_path)
    assert [p.name for p in places] == ["0000", "0001"]
    answer = open_seal(places[0], tmp_path / "sealed" / "0000.json")
    assert answer == FieldAnswer.from_json(finished[1][0]["answer"])
    assert not list((tmp_path / "results").iterdir())
    documents = {place.name: {"verdict": "unexplained"} for place in places}
    judged = study(REQUESTS, lambda model, recordings, holdout: documents[model.parent.name], tmp_path)
    assert [r["score"]["outcome"] for r in judged] == ["unexplained", "unexplained"]
