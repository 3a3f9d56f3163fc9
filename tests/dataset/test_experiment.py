"""Recordings made ready: loops cut in two, bursts without a stated controller, excitation that ran before the recording."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import joined, prepare
from afdsvc.dataset.split import split
from afdsvc.errors import BadInput
from afdsvc.identify.pipeline import planned
from afdsvc.lti.statespace import StateSpace

DT = 1e-2
LAG = StateSpace(np.array([[0.9]]), np.array([[0.1]]), np.array([[1.0]]), np.zeros((1, 1)), DT)
CONTROLLER = StateSpace(np.array([[0.95]]), np.array([[1.0]]), np.array([[-0.4]]), np.array([[-0.7]]), DT)


def model(known: bool) -> Model:
    return Model("lag", (Variable("force", "N"),), (Variable("place", "m"),), (Variable("x"),), LAG, controller=CONTROLLER if known else None)


def loop(samples: int = 600, seed: int = 0) -> Trace:
    """The loop sample by sample: ``x+ = 0.9 x + 0.1 u``, the controller's state beside it, a burst added to its output."""
    rng = np.random.default_rng(seed)
    x = c = 0.0
    rows = []
    for alpha in rng.normal(size=samples):
        y = x + 0.1 * rng.normal()
        u = -0.4 * c - 0.7 * y + alpha
        rows.append((u, y, alpha))
        x, c = 0.9 * x + 0.1 * u, 0.95 * c + y
    return Trace("r", DT, (Channel("u_force"), Channel("y_place"), Channel("alpha_force")), np.array(rows))


def test_readings_beyond_all_sizes_are_refused_by_explain_and_identify():
    trace = loop()
    huge = replace(trace, values=trace.values * [1.0, 1e250, 1.0])
    with pytest.raises(BadInput, match="r: y_place has values of up to"):
        prepare(model(False), [huge])
    assert "r: y_place has values of up to" in planned(model(False), [huge]).sentence


def test_what_was_added_to_a_known_controllers_output_is_the_burst():
    trace = loop()
    (run,) = prepare(model(True), [trace])
    assert run.W[:, 0] == pytest.approx(trace.column("alpha_force"))


def test_a_part_of_a_loop_holds_what_the_controllers_state_gave():
    """From rest at the cut, the controller and W together give the recorded input again."""
    (run,) = prepare(model(True), [loop()])
    part = run.span(200, 500)
    c, given = 0.0, []
    for y, w in zip(part.Y[:, 0], part.W[:, 0], strict=True):
        given.append(-0.4 * c - 0.7 * y + w)
        c = 0.95 * c + y
    assert given == pytest.approx(part.U[:, 0])


def test_without_a_stated_controller_the_recorded_burst_is_what_was_added():
    trace = loop()
    (run,) = prepare(model(False), [trace])
    assert run.W[:, 0] == pytest.approx(trace.column("alpha_force"))
    assert run.span(100, 300).W[:, 0] == pytest.approx(trace.column("alpha_force")[100:300])


@pytest.mark.parametrize(("skipped", "steady"), [(0, False), (200, True)])
def test_outputs_that_repeat_from_the_first_sample_are_steady(skipped, steady):
    rng = np.random.default_rng(1)
    u = np.tile(np.sign(rng.normal(size=20)).repeat(10) + 3.0, 6)
    x, y = 0.0, []
    for v in u:
        y.append(x + 1e-3 * rng.normal())
        x = 0.9 * x + 0.1 * v
    values = np.column_stack([u, y])[skipped:]
    (run,) = prepare(model(False), [Trace("r", DT, (Channel("u_force"), Channel("y_place")), values)])
    assert run.period == 200
    assert run.steady == steady


def test_parts_of_one_recording_are_put_together_and_others_are_not():
    rng = np.random.default_rng(1)
    whole = Trace("r", 0.01, (Channel("u_a"), Channel("y_b")), rng.standard_normal((300, 2)), t0=5.0)
    parts = [replace(whole, values=whole.values[a:b], t0=5.0 + 0.01 * a) for a, b in ((0, 100), (100, 220), (220, 300))]
    (again,) = joined(parts)
    assert again.t0 == whole.t0
    np.testing.assert_array_equal(again.values, whole.values)
    apart = [parts[0], replace(parts[1], t0=0.0), replace(parts[2], channels=(Channel("u_a"), Channel("y_c")))]
    assert [len(t) for t in joined(apart)] == [100, 120, 80]
    wave = np.tile(np.sin(np.arange(50) * 2 * np.pi / 50), 6)
    steady = replace(whole, values=np.column_stack([wave, wave]))
    levels = [replace(steady, values=level * steady.values, t0=3.0 * k) for k, level in enumerate((1.0, 2.0))]
    assert len(joined(levels)) == 2


def lag(seed, samples=900, noise=0.005):
    """A first-order lag under a staircase, from rest, its output read with noise."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, samples // 30), 30)
    y = lfilter([0.0, 0.05], [1, -0.95], u) + noise * rng.standard_normal(samples)
    return Trace("r", DT, (Channel("u_a"), Channel("y_b")), np.column_stack([u, y]))


def test_parts_whose_clocks_begin_anew_are_known_by_their_signals():
    whole = lag(1, noise=0.001)
    parts = [replace(whole, values=whole.values[a:b]) for a, b in ((0, 310), (310, 620), (620, 900))]
    (again,) = joined(parts)
    np.testing.assert_array_equal(again.values, whole.values)
    assert len(joined([parts[0], parts[2]])) == 2
    assert len(joined([parts[1], parts[0]])) == 2


def test_recordings_of_their_own_are_rarely_taken_for_parts():
    """Each begins at rest, or somewhere in a run of its own: of 190 pairs of independent recordings 1 % may go on by chance (7 or more: once in a thousand)."""
    runs = list(map(lag, range(100)))
    assert all(len(joined([a, b])) == 2 for a in runs[:10] for b in runs[10:20])
    cut = [replace(t, values=t.values[200:]) for t in runs[:20]]
    assert sum(len(joined([a, b])) == 1 for k, a in enumerate(cut) for b in cut[:k]) <= 6
    halves = [(replace(t, values=t.values[200:k]), replace(t, values=t.values[k:])) for t, k in zip(runs, range(400, 500), strict=True)]
    assert sum(len(joined(pair)) == 1 for pair in halves) >= 60


def test_recordings_that_all_begin_and_end_at_rest_stay_apart():
    """Their signals go on across the seam, but each begins where the first one began."""
    moves = [replace(t, values=t.values - t.values[0]) for t in (lag(k, noise=1e-4) for k in (1, 2))]
    shape = np.sin(np.pi * np.linspace(0, 1, 900))[:, None] ** 2
    rested = [replace(t, values=t.values * shape) for t in moves]
    assert len(joined(rested)) == 2


@pytest.mark.parametrize(("begin", "seen"), [((0.0, 0.0, 0.0), (0.0, 6.0, 12.0)), ((5.0, 20.0, 0.0), (5.0, 20.0, 26.0)), ((0.0, 6.0, 12.0), (0.0, 6.0, 12.0))])
def test_laws_see_recordings_one_after_the_other(begin, seen):
    runs = prepare(model(False), [replace(loop(), t0=t) for t in begin])
    assert [r.begins for r in runs] == pytest.approx(seen)
    assert runs[1].span(100, 200).begins == pytest.approx(seen[1] + 100 * DT)
    assert [r.t0 for r in runs] == list(begin)


def moving(samples: int) -> Trace:
    return Trace(f"of {samples}", 0.01, (Channel("u_force"), Channel("y_place")), np.random.default_rng(samples).standard_normal((samples, 2)))


def test_a_short_recording_counts_beside_others():
    runs = prepare(model(False), [moving(16), moving(40)])
    assert [len(r) for r in runs] == [16, 40]
    with pytest.raises(BadInput, match="of 15: 15 samples; expected at least 16"):
        prepare(model(False), [moving(15), moving(40)])
    with pytest.raises(BadInput, match="of 16, of 33: 49 samples; expected at least 50"):
        prepare(model(False), [moving(16), moving(33)])


def test_what_is_held_out_has_fifty_samples_together():
    long = prepare(model(False), [moving(200)])
    assert [len(r) for r in split(long, prepare(model(False), [moving(16), moving(34)])).heldout] == [16, 34]
    with pytest.raises(BadInput, match="of 51: 49 samples to be held out; expected at least 50"):
        split(long, [r.span(0, 49) for r in prepare(model(False), [moving(51)])])
    chosen = split(prepare(model(False), [moving(200), moving(60), moving(16)]), [])
    assert ([len(r) for r in chosen.train], [len(r) for r in chosen.heldout]) == ([200, 16], [60])
