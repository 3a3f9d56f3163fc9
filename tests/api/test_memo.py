"""What is kept for a machine or a block is the same result: never stale, never another's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.memo import Memo
from afdsvc.detect.features.front_end import front_end
from afdsvc.detect.features.nuisances import NONE
from afdsvc.detect.features.regressors import regressors, without_faults
from afdsvc.detect.features.shared_filter import shared_regressors
from afdsvc.detect.features.whiteness_gate import Gate
from afdsvc.excite.simulated_burst import simulate_burst
from afdsvc.testing.machines import bearing_problem, with_rate


def test_equal_values_are_one_key_and_equal_arrays_are_two():
    memo, made = Memo(), []
    a, b = np.arange(3.0), np.arange(3.0)
    for key in (("x", 1.5), ("x", 1.5), ("x", 2.5), ("y", 1.5), (a,), (a,), (b,)):
        memo(lambda key=key: made.append(key), *key)
    assert len(made) == 5, "an equal array elsewhere may change on its own"


def test_only_the_last_results_are_kept():
    memo, made = Memo(4), []
    for key in (0, 1, 2, 3, 4, 4, 3, 0):
        memo(lambda key=key: made.append(key) or key, key)
    assert made == [0, 1, 2, 3, 4, 0]


def test_problems_of_one_machine_share_what_does_not_depend_on_their_rates():
    problem = bearing_problem()
    rarer = with_rate(problem, per_burst=1e-5)
    assert regressors(rarer) is regressors(problem)
    louder = replace(problem, covariance=4 * problem.covariance)
    assert regressors(louder) is not regressors(problem)
    np.testing.assert_allclose(regressors(louder).Li, regressors(problem).Li / 2)


def test_two_detectors_that_look_at_the_same_samples_get_one_result_and_it_is_right():
    problem = bearing_problem()
    rarer, gate = with_rate(problem, per_burst=1e-5), Gate(window=100, lags=3)
    first, second = (front_end(p, without_faults(p), gate, NONE) for p in (problem, rarer))
    assert first is second
    assert front_end(problem, shared_regressors(problem), gate, NONE) is not first
    rng = np.random.default_rng(1)
    (block,) = simulate_burst(problem, np.zeros((80, 2)), 1e-6 * rng.normal(size=(80, 2))).blocks(80)
    (state, stages), again = first.step(block, first.rest), second.step(block, second.rest)
    assert again[0] is state
    sums, s = state.gate.sums(), stages[0].series[:, 0]
    lagged = sum(np.outer(s[t], s[t - 2]) for t in range(2, 25))
    assert first.gate.part == 25
    np.testing.assert_allclose(state.gate.parts[0].residual[2], lagged, rtol=1e-12)
    assert sums.n == 80
    later = first.step(replace(block, k0=80), state)[0]
    assert later is not state
    assert later.gate.sums().n == 110  # the last four parts of 25 and the one begun


def test_a_burst_is_known_by_what_is_played():
    one = Burst("one", 1, 100, 10, (Line(0, 300.0, 1.0),))
    again, larger = Burst("two", 1, 100, 10, (Line(0, 300.0, 1.0),)), Burst("one", 1, 100, 10, (Line(0, 300.0, 2.0),))
    wave = Burst("one", 1, 100, 10, (), np.ones((100, 1)))
    assert one.content == again.content
    assert len({b.content for b in (one, again, larger, wave)}) == 3
