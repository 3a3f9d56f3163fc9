"""A study runs, resumes, survives a failing `explain`, and reports what it found."""

from __future__ import annotations

import importlib
import json
from collections import Counter
from dataclasses import replace

import pytest

from afdsvc.errors import BadInput, Refused
from afdsvc.trial import Options, Request, TrialRequest, make_trial, markdown, page, plan, results, study
from afdsvc.trial import matching as rival
from afdsvc.trial.pages import confusion_matrix, tables, wilson
from afdsvc.trial.study import MIX, refusals, rescored

module = importlib.import_module("afdsvc.trial.study")
SHORT = Options(controller="proportional", periods=1)
REQUESTS = [
    Request(0, "bearing", (TrialRequest("coulomb_friction", "state:horizontal_rate", 0.3),), SHORT, (1, 0)),
    Request(1, "nothing", (), SHORT, (1, 1)),
    Request(2, "change", (TrialRequest("parameter_change:mass", "state:vertical_rate", 1.0),), SHORT, (1, 2)),
]


class Says:
    """An explanation that is always the same, and counts how often it was asked."""

    def __init__(self, document: dict) -> None:
        self.document, self.asked = document, 0

    def __call__(self, model, recordings, holdout) -> dict:
        assert model.exists()
        assert holdout.exists()
        assert len(recordings) == 3
        assert sorted(p.name for p in model.parent.iterdir()) == [
            "MODEL.toml", "SEAL.json", "holdout.npz", "recording_1.npz", "recording_2.npz", "recording_3.npz",
        ]
        self.asked += 1
        return self.document


FRICTION = {
    "verdict": "omitted_physics",
    "named": [{"physics": "coulomb_friction", "site": "state:horizontal_rate", "weight": 0.95}],
    "located": [{"output": "horizontal"}],
}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder, explain = tmp_path_factory.mktemp("study"), Says(FRICTION)
    with pytest.MonkeyPatch.context() as quick:  # how well a rival is fitted is tested with the oracle
        quick.setattr(rival, "STARTS", 1)
        quick.setattr(rival, "STEPS", 2)
        return folder, explain, study(REQUESTS, explain, folder)


def test_study_scores_every_trial(finished) -> None:
    _, explain, kept = finished
    assert explain.asked == 3
    right, nothing, change = (r["score"] for r in kept)
    assert right["first"] is True
    assert right["held_share"] is None
    assert nothing["confident_false"] is True
    assert change["first"] is False
    assert kept[2]["apart"] > 4.65
    assert kept[0]["apart"] is None


def test_study_goes_on_where_it_stopped(finished) -> None:
    folder, _, kept = finished
    (folder / "results" / "0001.json").unlink()
    again = Says(FRICTION)
    repeated = study(REQUESTS, again, folder)
    assert again.asked == 1
    assert repeated[1]["answer"] == kept[1]["answer"]
    assert results(folder) == repeated


def test_study_refuses_the_folder_of_another_study(finished) -> None:
    folder, _, _ = finished
    with pytest.raises(BadInput, match="another study"):
        study(REQUESTS[:2], Says(FRICTION), folder)


def test_recordings_are_removed_and_answers_kept_apart(finished) -> None:
    folder, _, _ = finished
    assert not list((folder / "trials").iterdir())
    assert len(list((folder / "sealed").iterdir())) == 3


def test_failing_explain_is_a_result(tmp_path) -> None:
    def explain(model, recordings, holdout) -> dict:
        raise ValueError("no idea")

    kept = study(REQUESTS[1:2], explain, tmp_path)
    assert kept[0]["score"]["verdict"] == "error"
    assert "no idea" in kept[0]["explanation"]["error"]


def test_a_trial_that_no_machine_allows_is_left_out_and_the_others_run(tmp_path, monkeypatch) -> None:
    made = module.make_trial

    def refusing(request):
        if request.number == 2:
            raise Refused("no machine allows it")
        return made(request)

    monkeypatch.setattr(module, "make_trial", refusing)
    for _ in range(2):  # it is not tried again
        kept = study([REQUESTS[2], REQUESTS[1]], Says({"verdict": "consistent", "named": [], "located": []}), tmp_path)
        assert [r["number"] for r in kept] == [1]
    assert refusals(tmp_path) == ["no machine allows it"]


def test_report_shows_rates_failures_and_confusion(finished) -> None:
    _, _, kept = finished
    text = markdown(kept)
    assert "3 trials over 2 kinds of effect; 1 with nothing hidden, of which 1 were given a name (1 with confidence)" in text
    assert "| 0.3 | 1 of 1 (100 %" in text
    assert "| nothing | 1 | coulomb_friction 1 |" in text
    failures = tables(kept)[-1].rows
    assert [row[0] for row in failures] == ["1", "2"]
    html = page(kept)
    assert "<table class=matrix>" in html
    assert html.count("<h2>") == 7


def test_confusion_matrix_counts_every_single_question(finished) -> None:
    hidden, said, counts = confusion_matrix(finished[2])
    assert hidden == ["coulomb_friction", "nothing", "parameter_change (mass)"]
    assert said == ["coulomb_friction"]
    assert counts.sum() == 3


def test_kept_results_can_be_scored_anew(finished) -> None:
    kept = finished[2][0]
    assert rescored(json.loads(json.dumps(kept)))["score"] == kept["score"]


def test_wilson_interval_is_the_published_one() -> None:
    """Newcombe, Statistics in Medicine 17 (1998), table I: 81 of 263 gives 0.2553 to 0.3662."""
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert wilson(0, 20)[0] == 0.0


def test_plan_covers_the_vocabulary_and_every_part() -> None:
    requests = plan(300, 7)
    assert len(requests) == 300
    assert Counter(r.part for r in requests) == MIX
    assert requests == plan(300, 7)
    assert requests != plan(300, 8)
    kinds = {w.physics for r in requests for w in r.wishes}
    assert len(kinds) >= 35 + 5 + 5
    severities = Counter(w.rho for r in requests if r.part == "bearing" for w in r.wishes)
    assert min(severities.values()) > 0.9 * max(severities.values())
    assert {r.options.injection for r in requests} == {"youla", "added"}


def test_small_plan_has_every_part() -> None:
    assert {r.part for r in plan(12, 1)} == set(MIX)


def test_trial_that_does_not_fit_is_made_smaller_or_elsewhere() -> None:
    asked = Request(0, "bearing", (TrialRequest("sensor_offset", "output:horizontal", 1.0),), replace(SHORT, controller="lqg"), (3, 0))
    trial = make_trial(asked)
    assert trial.options.controller == "proportional"  # the observer loop would leave the bearing's reach
    assert trial.answer.hidden[0].rho == pytest.approx(1.0, rel=0.05)
