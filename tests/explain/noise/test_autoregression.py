import numpy as np

from afdsvc.explain.noise.surrogates import autoregressive, colour, whiten


def test_a_known_model_is_found_and_its_innovations_are_white():
    rng = np.random.default_rng(1)
    w = rng.normal(size=20000)
    x = colour(w, np.array([1.0, -1.6, 0.8]))
    a = autoregressive([x[:9000], x[9000:]], 2)
    np.testing.assert_allclose(a, [1, -1.6, 0.8], atol=0.02)
    found = whiten(x, a)
    assert abs(np.corrcoef(found[1:], found[:-1])[0, 1]) < 0.02


def test_colouring_undoes_whitening():
    x = np.random.default_rng(2).normal(size=(300, 2))
    a = np.array([1.0, -0.9, 0.3])
    np.testing.assert_allclose(colour(whiten(x, a), a), x, atol=1e-12)


def test_an_exploding_series_gives_no_exploding_model():
    x = 1.02 ** np.arange(400) + np.random.default_rng(3).normal(size=400)
    assert np.abs(np.roots(autoregressive([x], 3))).max() <= 1 + 1e-6
