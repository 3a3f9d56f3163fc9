"""The CUSUMs of many hypotheses from shared products, against a direct loop over samples and hypotheses."""

import numpy as np
import pytest

from afdsvc.detect.statistics.cusum import cusum


def direct(e, waves, severity, block, boundary):
    """The textbook recursion, looked at once a block: g at the crossing or end, the sample, scores and information since zero."""
    H = len(severity)
    g, ratio = np.zeros(H), np.zeros(H)
    since = np.zeros(H, dtype=int)
    for t in range(len(e)):
        s = severity[:, None] * waves[t]
        ratio += s @ e[t] - 0.5 * np.sum(s**2, axis=1)
        if (t + 1) % block:
            continue
        g, ratio = np.maximum(g + ratio, 0.0), np.zeros(H)
        since[g == 0] = t + 1
        if g.max() > boundary:
            break
    who = int(np.argmax(g))
    own, left = waves[since[who] : t + 1], e[since[who] : t + 1]
    return g, who, t, np.einsum("thp,tp->h", own, left), np.einsum("thp,thp->h", own, own)


@pytest.fixture
def case():
    rng = np.random.default_rng(4)
    theta, severity = rng.normal(size=(7, 2, 5)), rng.uniform(-0.3, -0.02, 7)
    features, e = rng.normal(size=(3000, 5)), rng.normal(size=(3000, 2))
    e[1500:] += 0.05 * severity[2] * (features @ theta[2].T)[1500:] / abs(severity[2])
    return theta, severity, features, e


@pytest.mark.parametrize("block", [1, 7, 100])
@pytest.mark.parametrize("boundary", [4.0, 1e9])
def test_shared_products_give_the_textbook_recursion(case, block, boundary):
    theta, severity, features, e = case
    test = cusum(theta, severity, range(7), block, boundary)
    state, at, who = test.step(test.start(), np.hstack([e, features]))
    g, highest, t, b, G = direct(e, np.einsum("hpf,tf->thp", theta, features), severity, block, boundary)
    np.testing.assert_allclose(state.g, g, rtol=1e-9, atol=1e-9)
    assert (at < 0) == (g.max() <= boundary)
    if at >= 0:
        assert (at, who) == (t, highest)
        found = test.finding(state, who, list("abcdefg"), (-1.0, 0.0), at)
        wanted = np.clip(b / G, -1, 0)
        np.testing.assert_allclose([f.severity for f in found.fits], wanted, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose([f.sd for f in found.fits], G**-0.5, rtol=1e-9)


def test_blocks_cut_anywhere_give_the_same_bits(case):
    theta, severity, features, e = case
    test, flat = cusum(theta, severity, range(7), 25, 1e9), np.hstack([e, features])
    whole, _, _ = test.step(test.start(), flat)
    state = test.start()
    for a in range(0, len(flat), 41):
        state, _, _ = test.step(state, flat[a : a + 41])
    for one, other in ((whole.g, state.g), (whole.began, state.began), (whole.cross, state.cross)):
        assert np.array_equal(one, other)


def test_what_a_sample_costs_does_not_follow_the_hypotheses(case):
    theta = case[0]
    few, many = (cusum(np.repeat(theta, k, axis=0), np.full(7 * k, -0.1), range(7 * k), 25, 1.0).start() for k in (1, 20))
    assert few.cross.shape == many.cross.shape
    assert few.square.shape == many.square.shape
