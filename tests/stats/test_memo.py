"""Work done once for several detectors is the same work: never stale, never another's."""

from __future__ import annotations

import numpy as np

from afdsvc.api.bursts import Burst, Line
from afdsvc.stats.memo import Once, Played
from afdsvc.stats.whiteness import LagSums


def test_the_same_objects_are_worked_on_once_and_equal_ones_again() -> None:
    calls, once = [], Once(2)
    a, b = np.arange(3.0), np.arange(3.0)

    def work(x: np.ndarray) -> float:
        calls.append(x)
        return float(x.sum())

    assert [once(work, a), once(work, a), once(work, b)] == [3.0, 3.0, 3.0]
    assert len(calls) == 2, "an equal array elsewhere may change on its own"


def test_views_of_the_same_memory_are_the_same_and_others_are_not() -> None:
    seen, once, a = [], Once(4), np.arange(10.0)
    for view in (a[2:5], a[2:5], a[2:6], a[2:8:2], a[3:6]):
        once(lambda v: seen.append(v), view)
    assert len(seen) == 4


def test_only_the_last_results_are_kept() -> None:
    seen, once = [], Once(2)
    things = [object() for _ in range(3)]
    for thing in (*things, things[0]):
        once(lambda t: seen.append(t), thing)
    assert len(seen) == 4


def test_sums_of_two_who_see_the_same_samples_are_one_object_and_right() -> None:
    rng = np.random.default_rng(1)
    start, series = LagSums.empty(3, 1, 2), rng.normal(size=(40, 2, 2))
    first, second = start.add(series), start.add(series)
    assert first is second
    s = series[:, 0]
    np.testing.assert_allclose(first.residual[2], sum(np.outer(s[t], s[t - 2]) for t in range(2, 40)), rtol=1e-12)
    other = start.add(series.copy())
    assert other is not first
    assert np.array_equal(other.own, first.own)


def test_a_burst_is_known_by_what_is_played() -> None:
    one = Burst("one", 1, 100, 10, (Line(0, 300.0, 1.0),))
    again, larger = Burst("two", 1, 100, 10, (Line(0, 300.0, 1.0),)), Burst("one", 1, 100, 10, (Line(0, 300.0, 2.0),))
    wave = Burst("one", 1, 100, 10, (), np.ones((100, 1)))
    assert Played.of(one) == Played.of(again)
    assert hash(Played.of(one)) == hash(Played.of(again))
    assert len({Played.of(b) for b in (one, again, larger, wave)}) == 3
