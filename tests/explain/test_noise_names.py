"""Noise told from noise: coloured, in steps, growing with the level; against noise made up with known properties."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest
from scipy.signal import lfilter

from afdsvc.api.physics import Size
from afdsvc.dataset.experiment import Run
from afdsvc.dataset.periods import fold
from afdsvc.explain.coloured import coloured, faintly_coloured
from afdsvc.explain.explain import explain
from afdsvc.explain.stationary import growth
from afdsvc.explain.stepped import stepped
from afdsvc.files.model.model_file import read_model
from afdsvc.plugins.physics import afdsvc_physics
from afdsvc.stats.periodic import repeated
from afdsvc.trial import Options, generate
from afdsvc.trial.model_text import model_text
from afdsvc.trial.plan import make_trial, plan

PERIOD, PERIODS = 1000, 5


def run(name: str = "r", level: float = 1.0, period: int = PERIOD) -> Run:
    n = period * PERIODS
    u = level * np.tile(np.random.default_rng(0).standard_normal((period, 1)), (PERIODS, 1))
    empty = np.zeros((n, 0))
    return Run(name, 1e-3, 0.0, u, np.zeros((n, 1)), empty, np.zeros((n, 1)), (), period=period)


def white(seed: int, sd: float = 1.0) -> np.ndarray:
    return sd * np.random.default_rng(seed).standard_normal((PERIOD * PERIODS, 1))


def first_order(seed: int, pole: float, rms: float) -> np.ndarray:
    return np.asarray(rms * np.sqrt(1 - pole**2) * lfilter([1], [1, -pole], white(seed), axis=0))


def test_white_noise_gets_no_name():
    named = [coloured([run()], [white(seed)], [("y", "m")], 1) for seed in range(20)]
    assert not any(named)


def test_first_order_noise_beside_white_noise_is_named_with_its_size_and_time():
    residuals = [white(1) + first_order(2, 0.9, 1.0), white(3) + first_order(4, 0.9, 1.0)]
    (name,) = coloured([run(), run()], residuals, [("y", "m")], 3)
    assert (name.physics, name.site, name.effect) == ("coloured_noise", "output:y", 3)
    assert name.parameters["rms"].value == pytest.approx(1.0, rel=0.15)
    assert name.parameters["correlation time"].value == pytest.approx(-1e-3 / np.log(0.9), rel=0.25)


@pytest.mark.parametrize("tell", [lambda r, e: coloured(r, e, [("y", "m")], 1), lambda r, e: faintly_coloured(r, e, [("y", "m")])])
def test_recordings_with_periods_of_different_lengths_are_taken_together(tell):
    runs = [run("a"), run("b", period=PERIOD // 2)]
    (name,) = tell(runs, [(white(k) + first_order(k + 4, 0.9, 1.0))[: len(r)] for k, r in enumerate(runs)])
    assert name.parameters["rms"].value == pytest.approx(1.0, rel=0.15)


def test_noise_that_alternates_is_told_as_it_is_and_of_a_predictor_not_at_all():
    """Differences of white noise correlate by -1/2 with their neighbours and with nothing else; a predictor that corrects too much leaves such."""
    residuals = [np.diff(white(seed), axis=0, prepend=0.0) for seed in (1, 2)]
    (name,) = coloured([run(), run()], residuals, [("y", "m")], 1)
    assert name.parameters["correlation of neighbours"].value == pytest.approx(-0.5, abs=0.03)
    assert name.parameters["rms"].value == pytest.approx(np.sqrt(2), rel=0.05)
    assert not coloured([run(), run()], residuals, [("y", "m")], 1, predicted=True)


def test_colour_is_colour_of_a_predictor_too():
    residuals = [white(1) + first_order(2, 0.9, 1.0), white(3) + first_order(4, 0.9, 1.0)]
    assert coloured([run(), run()], residuals, [("y", "m")], 1, predicted=True)


def test_a_tone_is_no_coloured_noise():
    t = np.arange(PERIOD * PERIODS) * 1e-3
    assert not coloured([run()], [white(1) + np.sin(2 * np.pi * 37.5 * t)[:, None]], [("y", "m")], 1)


def test_what_grows_with_the_level_is_no_noise():
    assert not growth([run("a"), run("b")], [white(1), white(2)]).matters
    found = growth([run("quiet"), run("loud", 2.0)], [white(1), white(2, 1.3)])
    assert found.matters
    assert (found.loud, found.quiet) == ("loud", "quiet")
    assert found.ratio == pytest.approx(1.69, rel=0.1)


def test_noise_that_is_louder_on_a_day_of_weaker_excitation_does_not_grow_with_it():
    assert not growth([run("quiet", 2.0), run("loud", 1.0)], [white(1), white(2, 1.3)]).matters
    assert not growth([run("quiet"), run("loud")], [white(1), white(2, 1.3)]).matters


def test_of_two_outputs_with_coloured_noise_the_more_coloured_one_is_told_first():
    pair = np.hstack([white(1) + first_order(2, 0.9, 0.5), white(3) + first_order(4, 0.9, 1.5)])
    one = run()
    both = Run("r", 1e-3, 0.0, one.U, np.zeros_like(pair), np.zeros((len(pair), 0)), np.zeros_like(pair), (), period=PERIOD)
    names = coloured([both], [pair], [("a", "m"), ("b", "m")], 2)
    assert [(n.site, n.effect) for n in names] == [("output:b", 2), ("output:a", 3)]


def test_coloured_noise_of_one_size_does_not_seem_to_grow():
    pairs = [(first_order(2 * s, 0.95, 1.0), first_order(2 * s + 1, 0.95, 1.0)) for s in range(30)]
    assert not any(growth([run("a"), run("b")], list(pair)).matters for pair in pairs)


def test_steps_are_named_when_they_matter_beside_the_noise():
    port = Size(0, "y", "m", 0.0, 1.0, 3.0, step=0.5)
    (name,) = stepped([port], np.array([0.4]), 1)
    assert (name.physics, name.site) == ("quantisation", "output:y")
    assert name.parameters["step"].value == 0.5
    assert not stepped([port], np.array([4.0]), 1)


def test_coarse_rounding_is_named_though_it_repeats_with_the_excitation():
    """A periodic signal is rounded alike in every period: what repeats is no sign of something else."""
    trial = generate("quantisation", "output:horizontal", 1.0, np.random.default_rng(12), Options(controller="proportional"))
    path = Path(mkdtemp()) / "model.toml"
    path.write_text(model_text(trial.machine))
    answer = explain(read_model(path), trial.recordings, (trial.holdout,), afdsvc_physics(), rehearse=False)
    assert answer.verdict == "omitted_physics"
    assert (answer.named[0].physics, answer.named[0].site) == ("quantisation", "output:horizontal")


def test_what_repeats_is_taken_over_and_what_does_not_is_left():
    one, (w, beside) = run(), (white(1) + 3.0, white(2))
    told = repeated(one, w, beside)
    assert np.array_equal(repeated(one, w, w), w)
    settled = slice(len(w) - len(fold(one, w)) * PERIOD, None)
    mean = [x[settled].reshape(-1, PERIOD).mean(0) for x in (told, w, beside)]
    np.testing.assert_allclose(mean[0], mean[1], atol=1e-12)
    np.testing.assert_allclose((told - beside)[settled].reshape(-1, PERIOD), np.tile(mean[1] - mean[2], (len(fold(one, w)), 1)), atol=1e-12)
    assert np.array_equal(repeated(replace(one, period=0), w, beside), w)


def test_a_law_that_only_predicts_noise_better_is_not_named():
    """Coloured noise of the sensors, white by the model: as a predictor of noise a damped mass is far better than nothing."""
    request = next(r for r in plan(300, 2028) if r.options.noise == "coloured")
    trial = make_trial(request)
    assert not trial.answer.hidden
    path = Path(mkdtemp()) / "model.toml"
    path.write_text(model_text(trial.machine))
    answer = explain(read_model(path), trial.recordings, (trial.holdout,), afdsvc_physics(), rehearse=False)
    assert {n.physics for n in answer.named} <= {"coloured_noise"}
