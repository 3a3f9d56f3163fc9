"""Readings that stand alone, distinguished from what machines do."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.dataset.glitches import Glitch, glitches, grid
from afdsvc.dataset.periods import fold
from afdsvc.explain.check.check import check
from afdsvc.explain.pipeline import explain
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT, PERIOD, PERIODS, NOISE = 1e-3, 500, 4, 0.01
PLANT = StateSpace(np.array([[0, 1.0], [-4e4, -30.0]]), np.array([[0.0], [4e4]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
MODEL = Model("spring", (Variable("force", "N"),), (Variable("position", "mm"),), (Variable("q", "mm"), Variable("v", "mm/s", rate_of="q")), PLANT)


def recording(seed: int, at: tuple[int, ...] = (), height: float = 5.0) -> Trace:
    rng = np.random.default_rng(seed)
    lines = np.arange(1, 60, 2)
    u = np.cos(2 * np.pi * np.outer(np.arange(PERIOD) / PERIOD, lines) + rng.uniform(0, 7, len(lines))).sum(1)
    u = np.tile(u, PERIODS)
    y = simulate(sample_zoh(PLANT, DT), u[:, None])[0][:, 0] + NOISE * rng.standard_normal(len(u))
    y[list(at)] += height
    return Trace(f"r{seed}", DT, (Channel("u_force"), Channel("y_position")), np.column_stack([u, y]))


def found_in(y: np.ndarray, period: int = 0, drive: np.ndarray | None = None) -> tuple[Glitch, ...]:
    return glitches(y, np.zeros((len(y), 1)) if drive is None else drive, period)


def reading(at: tuple[int, ...] = (), height: float = 5.0) -> np.ndarray:
    return recording(1, at, height).column("y_position").copy()


def test_single_samples_and_pairs_are_found_with_their_height():
    y = reading((300, 1203))
    y[850:852] += (3.0, -4.0)
    found = {g.sample: g.height for g in found_in(y, PERIOD)}
    assert found == {300: pytest.approx(5.0, abs=0.3), 850: pytest.approx(3.0, abs=0.3), 851: pytest.approx(-4.0, abs=0.3), 1203: pytest.approx(5.0, abs=0.3)}


def test_noise_of_any_machine_has_none():
    rng = np.random.default_rng(0)
    heavy = rng.standard_t(4, 20000)
    assert sum(len(found_in(rng.standard_normal(5000))) for _ in range(40)) == 0
    assert len(found_in(np.cumsum(heavy))) == 0
    assert not found_in(np.round(reading() / 0.5) * 0.5, PERIOD)  # one step of a coarse reading is none


def test_a_flicker_of_one_step_of_a_coarse_reading_is_none():
    y = np.round(3 * np.sin(2 * np.pi * 0.5 * np.arange(2000) * DT) / 0.5) * 0.5
    y[777] += 0.5
    assert not found_in(y)


def test_a_short_loud_passage_is_measured_by_itself():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        y = NOISE * rng.standard_normal(20000)
        y[9000:9060] += rng.standard_normal(60)
        assert not found_in(y)


@pytest.mark.parametrize("law", ["impact", "step", "long"])
def test_what_lasts_is_no_glitch(law):
    y, t = reading(), np.arange(PERIOD * PERIODS)
    y += {"impact": 2.0 * np.maximum(t - 700.4, 0), "step": 5.0 * (t >= 700), "long": 5.0 * ((t >= 700) & (t < 706))}[law]
    assert not found_in(y)


def test_what_recurs_with_the_excitation_is_of_the_machine():
    at = (300, 300 + PERIOD, 300 + 3 * PERIOD)
    assert not found_in(reading(at), PERIOD)
    assert len(found_in(reading(at))) == 3
    assert len(found_in(reading((300, 300 + PERIOD)), PERIOD)) == 2  # twice in four periods may be chance


def test_what_follows_a_pulse_of_the_excitation_at_once_is_its_answer():
    """An accelerometer on a machine that is struck for one sample."""
    drive = np.zeros((4000, 1))
    drive[[900, 2500], 0] = 3.0
    y = np.roll(drive[:, 0], 1) + NOISE * np.random.default_rng(0).standard_normal(4000)
    assert not found_in(y, drive=drive)
    assert [g.sample for g in found_in(y)] == [901, 2501]


@pytest.mark.parametrize("output", [[1.0, 0.0], [0.0, 1.0]])
def test_noiseless_answers_of_machines_have_none(output):
    """Square waves, chirps and multisines through a light spring, computed: nothing but rounding beside the answer."""
    t = np.arange(4000) * DT
    chirp = np.sin(2 * np.pi * (5 + 40 * t) * t)
    drives = (np.sign(np.sin(2 * np.pi * 3 * t)), np.where(t > 1, chirp, 0.0), np.clip(1.5 * np.sin(2 * np.pi * 7 * t), -1, 1))
    for u in drives:
        y = simulate(sample_zoh(StateSpace(PLANT.A, PLANT.B, np.array([output]), PLANT.D), DT), u[:, None])[0][:, 0]
        assert not found_in(y, drive=u[:, None])
        assert not found_in(y + 1e-6 * np.random.default_rng(0).standard_normal(4000), drive=u[:, None])


def test_many_are_no_accident():
    at = tuple(range(10, PERIOD * PERIODS, 97))
    assert not found_in(reading(at), PERIOD)


def test_they_count_for_nothing_and_it_is_said():
    traces = [recording(0, (1207,)), recording(1, (400, 1333))]
    runs = prepare(MODEL, traces)
    assert [np.flatnonzero(np.isnan(r.Y[:, 0])).tolist() for r in runs] == [[1207], [400, 1333]]
    assert np.isfinite(traces[0].values).all()  # the recording itself is not touched
    reported = [f for f in check(MODEL, traces) if f.topic in ("glitches", "gaps")]
    assert [f.topic for f in reported] == ["glitches", "glitches"]
    assert "r0: 1 of 2000 samples of y_position are isolated outliers, the largest at 1.207 s 4.93 mm" in reported[0].sentence


def test_what_recurs_is_kept_in_what_is_prepared():
    (run,) = prepare(MODEL, [recording(0, (300, 300 + PERIOD, 300 + 3 * PERIOD))])
    assert run.period == PERIOD
    assert np.isfinite(run.Y).all()


def test_the_noise_is_that_of_the_other_samples():
    *given, held = (recording(k, (207 + 111 * k, 1261 + 37 * k)) for k in range(4))
    answer = explain(MODEL, given, [held], afdsvc_physics(), experiment=False)
    assert answer.verdict == "consistent"
    assert answer.noise_floor == pytest.approx((NOISE,), rel=0.05)


def test_periods_with_few_missing_samples_are_filled_by_the_others():
    (run,) = prepare(MODEL, [recording(2, (1207,))])
    folded = fold(run, run.Y)
    assert folded is not None
    assert folded.shape == (3, PERIOD, 1)
    assert folded[1, 207, 0] == pytest.approx(folded[[0, 2], 207, 0].mean())
    holed = run.Y.copy()
    holed[600:700] = np.nan
    assert fold(run, holed) is None
    left = run.Y.copy()
    left[-1] = np.inf  # a simulation that left is not a gap
    assert fold(run, left) is None


def test_values_that_differ_by_less_than_they_are_stored_to_lie_on_no_grid():
    assert grid(np.repeat([0.0, 1e-300, 1.0], 4)) == 0.0
    assert grid(np.repeat([0.0, 0.5, 2.0], 4)) == 0.5
