"""The test for faint first-order noise, against Monte Carlo and against noise made up with known shares."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from afdsvc.dataset.experiment import Run
from afdsvc.explain.coloured import faintly_coloured
from afdsvc.stats.ar_noise import whiteness_p
from afdsvc.stats.first_order_noise import autocorrelation, first_order

PERIOD, PERIODS = 1000, 5


def coloured(generator: np.random.Generator, n: int, pole: float, share: float) -> np.ndarray:
    """Return noise of unit power of which ``share`` is first order."""
    slow = np.sqrt(1 - pole**2) * lfilter([1], [1, -pole], generator.standard_normal(n + 1000))[1000:]
    return np.asarray(np.sqrt(share) * slow + np.sqrt(1 - share) * generator.standard_normal(n))


def test_autocorrelation_is_that_of_the_definition() -> None:
    pieces = [np.random.default_rng(k).standard_normal(300) for k in (1, 2)]
    rho, n = autocorrelation(pieces)
    calm = [x - x.mean() for x in pieces]
    direct = [sum((x[k:] * x[:-k]).sum() for x in calm) / sum((x * x).sum() for x in calm) for k in range(1, 8)]
    assert n == 600
    assert np.allclose(rho[:7], direct)


def test_white_noise_shows_a_pole_no_more_often_than_the_bound_says() -> None:
    generator = np.random.default_rng(5)
    p = np.array([first_order([generator.standard_normal(1200) for _ in range(3)]).p for _ in range(1500)])
    for level in (0.2, 0.05, 0.01):
        often = (p < level).mean()
        assert often < level + 3 * np.sqrt(level / len(p))  # a bound, with 99.9 % confidence
        assert often > level / 4  # and no idle one


def test_share_and_its_standard_deviation_are_right() -> None:
    found = [first_order([coloured(np.random.default_rng(seed), 30000, 0.9, 0.05)], 0.9) for seed in range(60)]
    off = np.array([(f.share - 0.05) / f.sd for f in found])
    assert abs(off.mean()) < 0.5
    assert 0.75 < off.std() < 1.3  # 99.5 %


def test_it_sees_a_share_that_the_general_test_of_whiteness_does_not() -> None:
    seen = general = 0
    for seed in range(40):
        x = coloured(np.random.default_rng(seed), 22500, 0.9, 0.017)
        seen += first_order([x]).p < 1e-4
        general += whiteness_p([x[:, None]]) < 1e-4
    assert seen >= 28
    assert general < seen - 10


def run(seed: int, share: float) -> tuple[Run, np.ndarray]:
    n = PERIOD * PERIODS
    u = np.tile(np.random.default_rng(0).standard_normal((PERIOD, 1)), (PERIODS, 1))
    e = coloured(np.random.default_rng(seed), n, 0.9, share)[:, None]
    return Run("r", 1e-3, 0.0, u, np.zeros((n, 1)), np.zeros((n, 0)), np.zeros((n, 1)), (), period=PERIOD), e


def test_faint_colour_is_named_with_its_size_and_white_noise_is_not() -> None:
    pairs = [run(seed, 0.05) for seed in range(3)]
    (name,) = faintly_coloured([r for r, _ in pairs], [e for _, e in pairs], [("y", "m")])
    assert (name.physics, name.site, name.effect) == ("coloured_noise", "output:y", 1)
    rms = name.parameters["rms"]
    assert rms.sd is not None
    assert abs(rms.value - np.sqrt(0.05)) < 3 * rms.sd
    named = 0
    for seed in range(0, 300, 3):
        pairs = [run(1000 + seed + k, 0.0) for k in range(3)]
        named += bool(faintly_coloured([r for r, _ in pairs], [e for _, e in pairs], [("y", "m")]))
    assert named <= 1  # one in a thousand is allowed: two of a hundred would be a chance of 0.5 %


def test_what_repeats_with_the_excitation_alone_is_no_colour_of_the_noise() -> None:
    pairs = [run(seed, 0.0) for seed in range(3)]
    shape = coloured(np.random.default_rng(9), PERIOD, 0.95, 1.0)
    left = [e + 0.3 * np.tile(shape, PERIODS)[:, None] for _, e in pairs]
    assert first_order([e[:, 0] for e in left]).p < 1e-6
    assert not faintly_coloured([r for r, _ in pairs], left, [("y", "m")])
