"""The parts of location: false alarms of the line test, injection point, amplitude law, labels, loud spans, columns, measured data."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal, stats

from afdsvc.api.model import Model
from afdsvc.dataset.experiment import Run, prepare
from afdsvc.explain.baseline import baseline
from afdsvc.explain.locate import locate
from afdsvc.explain.locate_amplitude import law
from afdsvc.explain.locate_columns import bent, plays
from afdsvc.explain.locate_lines import splits
from afdsvc.explain.locate_sweep import push, responses, unwhitened
from afdsvc.explain.locate_time import loud_span
from afdsvc.explain.locate_tones import label
from afdsvc.explain.nominal import nominal
from afdsvc.explain.simulator import Simulator
from afdsvc.files.model.model_file import read_model
from afdsvc.files.tables.tables import read_table
from afdsvc.plants.gas_bearing import gas_bearing
from afdsvc.stats.ar_noise import fit

PERIOD, PERIODS, DT = 1000, 5, 1e-3


def run(level: float = 1.0, seed: int = 0, speed: float = 0.0) -> Run:
    """Five periods of odd lines to 200 Hz, one of four left out."""
    rng = np.random.default_rng(seed)
    t = np.arange(PERIOD)
    lines = np.array([k for i, k in enumerate(range(1, 200, 2)) if i % 4 != 3])
    u = np.cos(2 * np.pi * np.outer(t, lines) / PERIOD + rng.uniform(0, 2 * np.pi, len(lines))).sum(1)
    U = np.tile(level * u / u.std(), PERIODS)[:, None]
    n = len(U)
    aux = np.full((n, 1), speed)
    return Run("r", DT, 0.0, U, np.zeros((n, 2)), aux, np.zeros((n, 2)), ("speed",), period=PERIOD, settled=0)


@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_noise_alone_repeats_as_rarely_as_the_p_value_says(pole):
    """200 recordings of white or coloured noise, two outputs: at most 2 % of p below 0.01 (binomial, 99 % confidence)."""
    r, rng, small = run(), np.random.default_rng(5), 0
    for _ in range(200):
        e = signal.lfilter([1], [1, -pole], rng.standard_normal((len(r), 2)), axis=0)
        small += sum(s.total.p < 0.01 for s in splits([r], [e], 2 * np.pi * 200))
    assert stats.binomtest(small, 400, 0.02, alternative="greater").pvalue > 0.01


def test_even_distortion_is_found_on_even_lines_in_its_output_alone():
    r, rng = run(), np.random.default_rng(6)
    e = rng.standard_normal((len(r), 2))
    e[:, 1] += 0.3 * (r.U[:, 0] ** 2 - 1)
    first, second = splits([r], [e], 2 * np.pi * 300)
    assert first.total.p > 1e-3
    assert second.kinds["even"].p < 1e-10
    assert second.kinds["even"].power > 3 * max(second.kinds["odd"].power, second.kinds["excited"].power)
    assert second.total.power == pytest.approx(np.var(0.3 * r.U[:, 0] ** 2), rel=0.2)


@pytest.mark.parametrize("power", [1, 2, 3])
def test_the_amplitude_law_is_read_off_between_levels(power):
    runs = [run(level, 1) for level in (0.5, 1.0)]
    rng = np.random.default_rng(7)
    residuals = [0.3 * np.sign(r.U) * np.abs(r.U) ** power * [1, 0] + 0.3 * rng.standard_normal((len(r), 2)) for r in runs]
    found = law(runs, splits(runs, residuals, 2 * np.pi * 400)[0].per_run)
    assert abs(found.exponent - power) < 4 * found.sd + 0.02
    assert found.nonlinear == (power > 1)


@pytest.mark.parametrize(
    ("hertz", "word"), [(30.0, "1x rotation"), (60.05, "2x rotation"), (90.0, "3x rotation"), (50.1, "mains"), (100.2, "mains, harmonic 2"), (71.3, "unknown")]
)
def test_tones_are_labelled(hertz, word):
    assert label(2 * np.pi * hertz, [run(speed=2 * np.pi * 30.0)]) == word


def test_a_loud_span_is_found_and_noise_has_none():
    r, rng = run(), np.random.default_rng(8)
    e = rng.standard_normal((len(r), 2))
    assert loud_span([r], [e], 0) is None
    e[2600:3100, 0] *= 3
    found = loud_span([r], [e], 0)
    assert found.start == pytest.approx(2.6, abs=0.15)
    assert found.stop == pytest.approx(3.1, abs=0.15)
    # of 9, the mean over five periods takes its share: (9 (4/5)^2 + 4/25) / (4/5)
    assert found.ratio == pytest.approx(7.4, rel=0.3)
    assert loud_span([r], [e], 1) is None


def test_the_play_operator_keeps_its_distance_and_forgets_small_moves():
    x = np.cumsum(np.random.default_rng(9).standard_normal(500))
    (columns,) = plays([x])
    radius = 0.4 * np.sqrt(np.mean(x**2))
    followed = columns[:, 1] * np.sqrt(np.mean(x**2))
    assert np.abs(x - followed).max() <= radius * (1 + 1e-12)
    moving = np.flatnonzero(np.diff(followed))
    assert np.allclose(np.abs((x - followed)[moving + 1]), radius)


def test_bent_columns_hold_every_straight_line():
    x = np.random.default_rng(10).standard_normal(1000)
    x = np.clip(x, *np.quantile(x, [0.01, 0.99]))
    (columns,) = bent([x])
    assert np.allclose(columns.sum(1), 1)
    left = x - columns @ np.linalg.lstsq(columns, x, rcond=None)[0]
    assert np.abs(left).max() < 1e-3 * x.std()


def test_unwhitening_undoes_whitening():
    rng = np.random.default_rng(11)
    e = signal.lfilter([1], [1, -0.8], rng.standard_normal((400, 2)), axis=0)
    w = fit([e], 5)
    assert np.allclose(unwhitened(w, w(e)), e, atol=1e-10)


@pytest.mark.parametrize("place", ["input", "output"])
def test_responses_are_the_derivative_of_the_prediction(place):
    """A disturbance at an input or a sensor, sent through the sweep, is the difference of two runs of the simulator, whitened."""
    plant, rng = gas_bearing(), np.random.default_rng(12)
    model = Model(plant.name, plant.inputs, plant.outputs, plant.states, plant.continuous())
    nom, n = nominal(model, plant.sample_time), 300
    gain = 0.1 * rng.standard_normal((nom.plant.order, 2)) * [[1], [1], [10], [10], [0.01], [0.01]]
    sim, theta = Simulator(nom, gain), np.zeros(len(nom.entries))
    U, Y, f = rng.standard_normal((n, 2)), rng.standard_normal((n, 2)), rng.standard_normal(n)
    whitener = fit([signal.lfilter([1], [1, -0.8], rng.standard_normal((400, 2)), axis=0)], 3)
    d = np.outer(f, [1.0, 0.0])
    # a reading that says f more is a measurement of f less to the predictor, and f more in what it predicts
    both = [(U, Y, 0 * d), (U + d, Y, 0 * d) if place == "input" else (U, Y - d, d)]
    one, two = (_played(sim, theta, u, y, plant.sample_time) + more for u, y, more in both)
    states = push(sim, theta)[0][:, [0]] if place == "input" else np.zeros((nom.plant.order, 1))
    outputs = np.zeros((2, 1)) if place == "input" else np.array([[1.0], [0.0]])
    found = responses(sim, theta, f[:, None], states, outputs, whitener)[:, :, 0]
    assert np.allclose(found, whitener(two - one), atol=1e-9 * np.abs(found).max())


def _played(sim: Simulator, theta: np.ndarray, U: np.ndarray, Y: np.ndarray, dt: float) -> np.ndarray:
    return sim.run(Run("r", dt, 0.0, U, Y, np.zeros((len(U), 0)), 0 * Y, ()), theta, np.zeros(sim.nominal.plant.order)).y


@pytest.mark.parametrize(
    ("folder", "model", "name", "samples", "word", "site"),
    [
        ("emps", "model", "estimation", None, "velocity sign", "state:v"),
        ("silverbox", "model_physical", "multisine", 16384, "position", "state:v"),
        ("two_mass", "model", "multisine_A", None, "frequency", "resonance of the reading near 76.6 Hz"),
    ],
)
def test_measured_recordings_are_located(measured, folder, model, name, samples, word, site):
    """Axis: friction; oscillator: its spring; motor bench: the band of the flexible mode (published: 77 Hz)."""
    model = read_model(measured / folder / f"{model}.toml")
    (r,) = prepare(model, [read_table(measured / folder / f"{name}.csv")])
    places = locate(baseline(nominal(model, r.dt), [r.span(0, samples or len(r))]))
    assert word in places[0].depends_on
    assert site in places[0].evidence
