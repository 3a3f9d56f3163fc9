"""Bursts for identification: their spectra, crest factors, and what detection lines say about nonlinearity."""

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.excite.identification_bursts import (
    Band,
    distortion,
    grid_lines,
    multisine_burst,
    random_binary_burst,
    sweep_burst,
)

DT = 2e-4
BAND = Band(5.0, 500.0, np.array([1.0, 2.0]), DT)


def _rng():
    return np.random.default_rng(7)


def _harmonics(burst):
    period = int(burst.notes["period_samples"])
    return [
        sorted(round(line.omega * period * DT / (2 * np.pi)) for line in burst.lines if line.input == j)
        for j in range(2)
    ]


@pytest.mark.parametrize(
    "make",
    [
        lambda: random_binary_burst(BAND, 2.0, _rng()),
        lambda: multisine_burst(BAND, 2.0, _rng()),
        lambda: multisine_burst(BAND, 2.0, _rng(), "odd_random"),
        lambda: sweep_burst(BAND, 2.0),
        lambda: sweep_burst(BAND, 2.0, logarithmic=False),
    ],
)
def test_amplitude_is_kept_and_ends_are_zero(make):
    alpha = make().play(DT)
    assert alpha.shape == (10_000, 2)
    assert np.abs(alpha).max(axis=0) == pytest.approx([1.0, 2.0], rel=0.02)
    assert (np.abs(alpha).max(axis=0) <= np.array([1.0, 2.0]) * (1 + 1e-9)).all()
    assert np.abs(alpha[[0, -1]]).max() < 1e-9


def test_random_binary_is_flat_and_independent_between_inputs():
    alpha = random_binary_burst(BAND, 20.0, _rng()).play(DT)
    assert abs(np.corrcoef(alpha.T)[0, 1]) < 0.05
    spectrum = np.abs(np.fft.rfft(alpha[:, 0])) ** 2
    f = np.fft.rfftfreq(len(alpha), DT)
    low, high = spectrum[(f > 5) & (f < 100)].mean(), spectrum[(f > 400) & (f < 500)].mean()
    assert 0.3 < high / low < 0.8  # down by about 3 dB at the upper edge
    assert np.isin(np.unique(alpha[2500:-2500, 0]), [-1.0, 1.0]).all()


def test_multisine_has_exactly_its_lines_each_on_one_input_with_a_low_crest_factor():
    burst = multisine_burst(BAND, 2.0, _rng())
    first, second = _harmonics(burst)
    assert not set(first) & set(second)
    period = int(burst.notes["period_samples"])
    assert sorted(first + second) == list(grid_lines(BAND, period, "full", _rng())[0])
    alpha = burst.play(DT)
    settled = alpha[period : 2 * period]
    spectrum = np.abs(np.fft.rfft(settled[:, 0])) / period * 2
    assert np.isclose(spectrum[first], spectrum[first[0]], rtol=1e-9).all()
    assert np.delete(spectrum, first).max() < 1e-9 * spectrum[first[0]]
    assert np.abs(settled).max(axis=0) / settled.std(axis=0) == pytest.approx(
        [1.7, 1.7], abs=0.2
    )  # random phases: about 3.5


def test_odd_grids_hold_odd_lines_and_leave_one_of_four_out():
    odd, none = grid_lines(BAND, 5000, "odd", _rng())
    assert (odd % 2 == 1).all()
    assert not len(none)
    excited, left_out = grid_lines(BAND, 5000, "odd_random", _rng())
    assert sorted([*excited, *left_out]) == list(odd)
    assert len(left_out) == len(odd) // 4
    assert multisine_burst(BAND, 2.0, _rng(), "odd").notes["grid"] == "odd"


@pytest.mark.parametrize(
    ("nonlinearity", "where"),
    [(lambda a: a, None), (lambda a: a + 0.02 * a**2, "even"), (lambda a: a + 0.02 * a**3, "odd")],
)
def test_detection_lines_tell_even_from_odd_from_noise(nonlinearity, where):
    burst = multisine_burst(Band(5.0, 500.0, np.array([1.0]), DT), 2.0, _rng(), "odd_random")
    y = nonlinearity(burst.play(DT)[:, 0]) + 1e-3 * _rng().standard_normal(burst.samples)
    found = distortion(y, burst, [round(line.omega * 2500 * DT / (2 * np.pi)) for line in burst.lines])
    for kind in ("even", "odd"):
        ratio = found[kind] / found[f"noise_{kind}"]
        assert (ratio > 10) if kind == where else (ratio < 4)
    assert found["excited"] > 0.99


def test_sweep_passes_every_frequency_on_one_input_after_the_other():
    alpha = sweep_burst(BAND, 4.0).play(DT)
    assert not alpha[: len(alpha) // 2, 1].any()
    assert not alpha[len(alpha) // 2 :, 0].any()
    spectrum = np.abs(np.fft.rfft(alpha[:, 0]))
    f = np.fft.rfftfreq(len(alpha), DT)
    inside, outside = spectrum[(f > 8) & (f < 450)], spectrum[f > 700]
    assert inside.min() > 20 * outside.max()


def test_silent_inputs_stay_silent():
    burst = multisine_burst(Band(5.0, 500.0, np.array([0.0, 1.0]), DT), 2.0, _rng())
    assert {line.input for line in burst.lines} == {1}


def test_impossible_wishes_are_named():
    with pytest.raises(BadInput, match=r"band 5 to 4000 Hz; expected 0 < low < high <= 2500 Hz"):
        Band(5.0, 4000.0, np.ones(2), DT)
    with pytest.raises(BadInput, match="every amplitude is zero"):
        Band(5.0, 400.0, np.zeros(2), DT)
    with pytest.raises(BadInput, match="puts 3 lines between"):
        multisine_burst(Band(5.0, 16.0, np.ones(2), DT), 0.8, _rng())
    with pytest.raises(BadInput, match="grid 'even'"):
        multisine_burst(BAND, 2.0, _rng(), "even")  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="hold fewer than two settled periods"):
        distortion(np.zeros(3000), multisine_burst(BAND, 2.0, _rng()), [5])
