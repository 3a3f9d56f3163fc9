"""A perfect model in a closed loop: the noise of the output comes back in the input."""

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.explain.gap.decision import gap_test
from afdsvc.explain.gap.regression import projected
from afdsvc.explain.gap.settings import GapSettings
from afdsvc.explain.gap.signals import ResidualSignals
from tests.explain.gap.machines import coloured, speed, steps


def loop(rng, known, friction=0.0, n=1500, noise=0.1):
    r, e = steps(n, 40, rng), noise * coloured(n, 10.0, rng)
    u, v = np.zeros((n, 1)), np.zeros((n, 1))
    for t in range(n):
        if t:
            v[t] = 0.97 * v[t - 1] + 0.03 * (u[t - 1] - friction * np.tanh(50 * v[t - 1]))
        u[t] = 5 * (r[t] - v[t] - e[t])
    x = speed(u)
    return ResidualSignals(v + e - x, u, x, np.zeros((n, 0)), 0.01, 0, r if known else None)


def answer(r, seed):
    return gap_test([r], ["v"], ["u"], ["y"], [], np.random.default_rng(seed), 49, GapSettings(level=0.02))


def test_without_the_reference_noise_in_the_input_looks_like_a_gap():
    assert answer(loop(np.random.default_rng(1), known=False), 1).present


def test_with_the_reference_a_perfect_model_has_no_gap():
    assert [answer(loop(np.random.default_rng(i), known=True), i).present for i in range(4)] == [False] * 4


def test_with_the_reference_friction_is_still_found():
    found = answer(loop(np.random.default_rng(3), known=True, friction=0.4), 3)
    assert found.present
    assert found.total > 0.5


def test_a_reference_in_some_recordings_only_is_refused():
    rng = np.random.default_rng(4)
    with pytest.raises(BadInput, match="1 of 2 recordings have a reference"):
        projected([loop(rng, True), loop(rng, False)], rng, GapSettings())
