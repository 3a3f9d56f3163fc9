"""Field trials: what was asked is there, to the size that is stated; the same seed, the same trial; nothing on disk tells."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict

import numpy as np
import pytest

from afdsvc.errors import BadInput, Refused
from afdsvc.files.model.model_file import read_model
from afdsvc.trial import FIELD, FieldAnswer, FieldOptions, field_oracle, field_plan, make_trial, open_seal, seal, write
from afdsvc.trial.effect import Truth
from afdsvc.trial.field.catalogue import FAMILIES, FEATURES, LAWS, laws_at
from afdsvc.trial.field.generate import generate, make
from afdsvc.trial.field.simulation import play

ONE = FieldOptions("motor", ("dry",))
TWO = FieldOptions("arm", ("uneven_zone", "drag"), True)


@pytest.fixture(scope="module")
def trials():
    return {"one": make(ONE, 0.6, (4, 0)), "two": make(TWO, 0.5, (4, 1)), "nothing": make(FieldOptions("coil"), 0.0, (4, 2))}


def power(x: np.ndarray, y: np.ndarray) -> float:
    """Mean square of x over the variance of y, averaged over the columns."""
    return float(np.mean(np.square(x).mean(axis=0) / y.var(axis=0)))


@pytest.mark.parametrize("name", ["one", "two"])
def test_severity_is_the_stated_share_of_the_held_out_error(trials, name) -> None:
    """Counted anew for machines whose commands do not depend on what they answer."""
    trial = trials[name]
    rig, run, theta = trial.rig, trial.runs[-1], trial.truth.theta
    bare, hidden, nominal = (
        play(rig, t, run.quiet()).y[run.skip :] for t in (Truth(theta), Truth(theta, trial.truth.effects), Truth(rig.nominal))
    )
    without = play(rig, trial.truth.with_effects(), run).y[run.skip :]
    rest, effect = power(without - nominal, bare), power(hidden - bare, bare)
    asked = 0.6 if name == "one" else 0.5
    assert trial.answer.asked in (asked, pytest.approx(asked * 0.7), pytest.approx(asked * 0.5))
    assert trial.answer.share == pytest.approx(trial.answer.asked, abs=0.011)
    assert effect / (effect + rest) == pytest.approx(trial.answer.share, abs=0.03)
    assert all(h.share > 0.09 for h in trial.answer.hidden)
    assert rest > (1 - trial.answer.asked) * 0.05**2


def test_oracle_removes_at_least_about_what_is_the_effects(trials) -> None:
    best = field_oracle(trials["one"])
    assert 0 < best.after <= best.floor < best.before
    assert best.gain > 0.5 * trials["one"].answer.share


def test_nothing_hidden_is_noise_of_its_own_colour_and_constants_inside_what_is_stated(trials) -> None:
    trial = trials["nothing"]
    assert not trial.answer.hidden
    assert trial.answer.share == 0.0
    assert "coloured_noise" in trial.answer.present
    assert "parameter_change" not in trial.answer.present
    error = np.abs(trial.truth.theta / trial.rig.nominal - 1)
    assert error.max() <= 2 * trial.conditions.stated
    assert error.max() > 0


def test_same_seed_same_bits_and_another_differs() -> None:
    a, b, c = (make(FieldOptions("damper", ("slow_drag",)), 0.4, (s,)) for s in (5, 5, 6))
    assert np.array_equal(a.holdout.values, b.holdout.values)
    assert a.answer == b.answer
    assert a.holdout.values.shape != c.holdout.values.shape or not np.array_equal(a.holdout.values, c.holdout.values)


def test_recordings_have_the_fixed_columns_and_sizes(trials) -> None:
    for trial in trials.values():
        names = [c.name for c in trial.holdout.channels]
        assert all(n.split("_")[0] in ("u", "y", "ref", "aux") for n in names)
        assert 1 <= len(trial.recordings) <= 4
        assert all(500 <= len(t.values) <= 20_000 for t in (*trial.recordings, trial.holdout))
        assert all(np.isfinite(t.values).all() for t in (*trial.recordings, trial.holdout))


def test_folder_does_not_tell(trials, tmp_path) -> None:
    for name, trial in trials.items():
        paths = write(trial, tmp_path / name, "csv")
        kept = seal(trial.answer, paths, tmp_path / "vault")
        words = {h.law for h in trial.answer.hidden} | {w for h in trial.answer.hidden for w in h.accept} | {"share", "seed", "hidden"}
        for path in (tmp_path / name).iterdir():
            text = path.read_text(encoding="utf-8").lower()
            assert not any(word in text for word in words), path
        assert open_seal(tmp_path / name, kept) == trial.answer


def test_answer_survives_json(trials) -> None:
    for trial in trials.values():
        assert FieldAnswer.from_json(json.loads(json.dumps(trial.answer.as_json()))) == trial.answer


@pytest.mark.parametrize("family", sorted(set(FAMILIES) - {"pendulum"}))
def test_model_file_says_what_the_owner_believes(family, tmp_path) -> None:
    trial = make(FieldOptions(family), 0.0, (8, 1))
    model = read_model(write(trial, tmp_path, "csv").model, allow_code=True)
    assert [v.name for v in model.inputs] == [v.name for v in trial.rig.inputs]
    assert model.output_sd is None
    assert (model.controller is not None) == trial.rig.loop
    if trial.rig.code:
        values = [q.value for q in model.parameters.values()]
        assert values == pytest.approx(trial.rig.nominal)
    elif not trial.rig.black_box:
        assert all(np.array_equal(getattr(model.plant, k), m) for k, m in zip("ABCD", trial.rig.build(trial.rig.nominal), strict=True))
        assert not np.allclose(trial.truth.theta, trial.rig.nominal, rtol=1e-4)
    else:
        poles = np.exp(np.linalg.eigvals(trial.rig.build(trial.rig.nominal)[0]) * trial.rig.dt)
        assert np.sort_complex(np.linalg.eigvals(model.plant.A)) == pytest.approx(np.sort_complex(poles))


def test_pendulum_is_code_without_inputs(tmp_path) -> None:
    trial = make(FieldOptions("pendulum"), 0.0, (8, 1))
    paths = write(trial, tmp_path, "csv")
    assert "inputs = []" in paths.model.read_text()
    space: dict = {}
    exec(paths.code[0].read_text(), space)
    p, x = dict(zip(trial.rig.names, trial.rig.nominal, strict=True)), [0.3, -0.2]
    assert space["machine"].f(0.0, x, [], p) == pytest.approx([-0.2, -p["g_over_l"] * np.sin(0.3) + 0.2 * p["damping"]])
    assert abs(trial.holdout.column("y_angle")[0]) > 0.1  # it begins in motion


def test_plan_mixes_as_announced() -> None:
    requests = field_plan(1200, 7)
    assert requests[:100] == field_plan(100, 7)
    assert requests != field_plan(1200, 8)
    assert {r.part for r in requests} == {FIELD}
    hidden = [r for r in requests if r.wishes]
    outside = [r for r in hidden if any(w.physics == "outside" for w in r.wishes)]
    assert 1 - len(hidden) / 1200 == pytest.approx(0.15, abs=0.03)
    assert len(outside) / len(hidden) == pytest.approx(1 / 3, abs=0.05)
    assert np.mean([r.options.repeating for r in requests]) == pytest.approx(0.5, abs=0.05)
    assert set(Counter(r.options.family for r in requests).values()) == {100}
    assert {len(r.wishes) for r in hidden} == {1, 2, 3}
    assert all(0.2 <= w.rho <= 0.9 for r in hidden for w in r.wishes)
    assert {law for r in field_plan(4000, 7) for law in r.options.laws} == set(LAWS)
    json.dumps([asdict(r) for r in requests])


def test_every_family_has_laws_in_the_vocabulary_and_outside() -> None:
    assert set(FEATURES) == set(FAMILIES)
    for family in FAMILIES:
        assert {law.outside for law in laws_at(family)} == {True, False}
    assert all(not set(law.accept) & set(law.partial) for law in LAWS.values())


def test_bad_requests_are_refused() -> None:
    with pytest.raises(BadInput, match="family"):
        FieldOptions("aeroplane")
    with pytest.raises(BadInput, match="catalogue"):
        FieldOptions("motor", ("magic",))
    with pytest.raises(BadInput, match="no place"):
        generate(FieldOptions("motor", ("magnet",)), 0.5, np.random.default_rng(1))
    with pytest.raises(BadInput, match="between 0 and 1"):
        generate(ONE, 1.5, np.random.default_rng(1))
    with pytest.raises(Refused):
        generate(FieldOptions("coil", ("lame",)), 1 - 1e-12, np.random.default_rng(1))


def test_request_makes_its_trial() -> None:
    request = next(r for r in field_plan(60, 3) if r.options.family == "coil")
    trial = make_trial(request)
    assert trial.answer.options["family"] == "coil"
    assert trial.answer.seed.startswith("3/20/")


def test_operating_point_is_the_same_in_every_file() -> None:
    trial = next(t for t in (make(FieldOptions("tanks"), 0.0, (9, k)) for k in range(20)) if t.conditions.offset)
    for trace, played, run in zip((*trial.recordings, trial.holdout), trial.played, trial.runs, strict=True):
        added = trace.values[:, : played.u.shape[1]] - played.u[run.skip :]
        assert np.ptp(added, axis=0) == pytest.approx(0, abs=1e-9)
        assert added[0] == pytest.approx(trial.conditions.offset * np.sqrt(np.mean(np.square(trial.played[-1].u[trial.runs[-1].skip :]))))
