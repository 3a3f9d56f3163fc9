import dataclasses

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.explain.gap.decision import flexible_prediction, gap_test
from afdsvc.explain.gap.settings import GapSettings
from afdsvc.explain.gap.signals import ResidualSignals
from tests.explain.gap.machines import coloured, motor


def answer(recordings, seed=1, surrogates=49, **settings):
    return gap_test(recordings, ["v"], ["u"], ["y"], [], np.random.default_rng(seed), surrogates, GapSettings(**settings))


def test_missing_friction_is_a_gap_that_follows_the_speed():
    found = answer([motor(np.random.default_rng(1), 4000, friction=0.5, noise=0.05)])
    assert found.present
    assert found.enough
    assert found.r2[0] > 0.8
    assert found.blocks_won > 0.9
    lost = dict(found.depends_on)
    assert max(lost["state v"], lost["sign of v"], lost["amplitude"]) > lost["time"]
    assert "Gap: a flexible model predicts" in found.sentence


@pytest.mark.parametrize("time", [0.1, 20.0, 150.0])
def test_noise_of_any_colour_is_seldom_a_gap(time):
    rng = np.random.default_rng(2)
    found = [answer([motor(rng, noise=1.0, time=time)], seed) for seed in range(12)]
    assert sum(f.present for f in found) <= 1
    assert all(f.sentence.startswith("No gap found" if f.enough else "Too short to distinguish") for f in found if not f.present)


def test_process_noise_under_a_repeating_excitation_is_no_gap():
    present = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        r = motor(rng, 1600, period=400)
        present.append(answer([dataclasses.replace(r, residual=coloured(1600, 33.0, rng))], seed).present)
    assert sum(present) <= 1


def test_a_repeating_gap_is_measured_by_what_repeats():
    found = answer([motor(np.random.default_rng(3), 1600, friction=0.3, noise=0.05, period=400)], surrogates=99)
    assert found.present
    assert found.repeats[0] > 0.7
    assert found.within_reach[0] >= found.repeats[0]


def test_units_do_not_matter():
    r = motor(np.random.default_rng(4), friction=0.3)
    scaled = ResidualSignals(1e3 * r.residual, 1e3 * r.inputs, 1e3 * r.states, r.aux, r.dt)
    a, b = answer([r]), answer([scaled])
    assert (a.present, a.p_value) == (b.present, b.p_value)
    assert a.r2 == pytest.approx(b.r2, abs=1e-6)


def test_cutting_a_file_changes_little():
    r = motor(np.random.default_rng(5), 2000, friction=0.4)
    half = [ResidualSignals(r.residual[s], r.inputs[s], r.states[s], r.aux[s], r.dt) for s in (slice(0, 1000), slice(1000, 2000))]
    assert answer(half).present == answer([r]).present
    assert answer(half).total == pytest.approx(answer([r]).total, abs=0.1)


def test_a_short_recording_of_a_slow_residual_is_called_too_short():
    found = answer([motor(np.random.default_rng(6), 400, noise=1.0, time=60.0)])
    assert not found.enough
    assert "10 are needed" in found.sentence


def test_a_constant_is_an_offset_and_no_gap():
    rng = np.random.default_rng(7)
    r = motor(rng, noise=0.1)
    found = answer([dataclasses.replace(r, residual=r.residual + 5.0)])
    assert not found.present
    assert found.offset[0] > 0.99


def test_a_residual_of_zero_is_no_gap():
    found = answer([dataclasses.replace(motor(np.random.default_rng(8)), residual=np.zeros((1500, 1)))])
    assert not found.present
    assert found.r2 == (0.0,)


def test_missing_readings_are_not_counted_as_zero():
    r = motor(np.random.default_rng(9), 4000, friction=0.5, noise=0.05)
    holes = r.residual.copy()
    holes[300:500] = np.nan
    found = answer([dataclasses.replace(r, residual=holes)])
    assert found.present
    assert found.total == pytest.approx(answer([r]).total, abs=0.1)


def test_the_prediction_has_the_share_that_is_stated():
    rng = np.random.default_rng(10)
    recordings = [motor(rng, 900, friction=0.4), motor(rng, 700, friction=0.4)]
    found = answer(recordings, seed=5)
    predicted = flexible_prediction(recordings, ["v"], ["u"], ["y"], [], np.random.default_rng(5))
    E = [r.residual - r.residual.mean(0) for r in recordings]
    left = sum(((e - f) ** 2).sum() for e, f in zip(E, predicted, strict=True)) / sum((e**2).sum() for e in E)
    assert 1 - left == pytest.approx(found.r2[0], abs=1e-6)


def test_thinning_a_long_recording_changes_little():
    r = motor(np.random.default_rng(11), 6000, friction=0.4)
    all_rows, thinned = answer([r]), answer([r], rows=1000)
    assert thinned.present
    assert thinned.total == pytest.approx(all_rows.total, abs=0.1)
    predicted = flexible_prediction([r], ["v"], ["u"], ["y"], [], np.random.default_rng(1), GapSettings(rows=1000))[0]
    e = r.residual - r.residual.mean(0)
    assert 1 - ((e - predicted) ** 2).sum() / (e**2).sum() == pytest.approx(thinned.total, abs=0.1)


@pytest.mark.parametrize(("change", "match"), [
    ({"inputs": np.zeros((1500, 2))}, r"inputs has shape \(1500, 2\); expected \(1500, 1\)"),
    ({"states": np.full((1500, 1), np.inf)}, "states 'v' is inf at sample 0"),
    ({"residual": np.full((1500, 1), np.nan)}, "output 'y' has 0 % of its readings"),
])
def test_bad_input_is_named(change, match):
    r = dataclasses.replace(motor(np.random.default_rng(12)), **change)
    with pytest.raises(BadInput, match=match):
        answer([r])


def test_too_few_samples_or_recordings_are_named():
    with pytest.raises(BadInput, match="no recordings"):
        answer([])
    with pytest.raises(BadInput, match="40 samples in all recordings; expected at least 100"):
        answer([motor(np.random.default_rng(13), 40)])
    with pytest.raises(BadInput, match="level 2"):
        GapSettings(level=2.0)
