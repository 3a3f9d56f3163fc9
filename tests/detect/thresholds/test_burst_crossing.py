"""How often the largest of several CUSUMs crosses within a burst, against simulation and the run-length walk of one."""

import numpy as np
import pytest

from afdsvc.detect.thresholds import average_run_length
from afdsvc.detect.thresholds.burst_crossing import CrossingNoise, paths


def simulated(waves, boundary, runs, seed, draw=None):
    rng, (blocks, H, D) = np.random.default_rng(seed), waves.shape
    g, top = np.zeros((runs, H)), np.zeros(runs)
    own = None if draw is None else draw(rng, runs)
    for k in range(blocks):
        z = rng.normal(size=(runs, D))
        z = z if own is None else z @ own[1].T + own[0][:, k]
        g = np.maximum(g + z @ waves[k].T - 0.5 * np.sum(waves[k] ** 2, axis=1), 0)
        top = np.maximum(top, g.max(axis=1))
    return np.mean(top > boundary)


def different(blocks=20, H=6, D=4):
    """Waves of different directions, lengths and courses over the burst."""
    rng = np.random.default_rng(5)
    waves = rng.normal(size=(1, H, D)) * (1 + 0.5 * np.sin(np.arange(blocks))[:, None, None])
    wanted = np.array([4.0, 5.0, 8.0, 10.0, 16.0, 20.0])[:H]
    return waves * (wanted / np.sqrt(np.sum(waves**2, axis=(0, 2))))[None, :, None]


@pytest.mark.parametrize(("rate", "runs"), [(0.1, 100_000), (0.003, 1_000_000)])
def test_boundary_of_many_cusums_against_simulation(rate, runs):
    waves = different()
    found = simulated(waves, paths(waves).boundary(rate), runs, 1)
    assert found == pytest.approx(rate, abs=2.58 * np.sqrt(rate / runs) + 0.03 * rate)


@pytest.mark.parametrize("rate", [0.05, 1e-3, 1e-6])
def test_boundary_of_one_cusum_against_its_walk(rate):
    mu, blocks = 0.9, 40  # steps of 0.2 and more are not lumped together there
    waves = np.full((blocks, 1, 1), mu)
    assert average_run_length.alarm_probability(mu, paths(waves).boundary(rate), blocks) == pytest.approx(rate, rel=0.04)


def test_an_uncertain_model_counts_with_its_waves():
    waves = different()
    mean = np.stack([s * waves[:, 1] * 0.2 for s in (-1.0, 1.0)])
    root = np.linalg.cholesky(np.eye(4) + 0.1 * np.ones((4, 4)))
    noise = CrossingNoise(np.array([0.3, 0.7]), mean, np.stack([root, root]))
    boundary = paths(waves, noise).boundary(0.02)
    runs = 200_000
    found = simulated(waves, boundary, runs, 3, lambda g, n: (mean[(g.random(n) < 0.7).astype(int)], root))
    assert found == pytest.approx(0.02, abs=2.58 * np.sqrt(0.02 / runs) + 0.04 * 0.02)
    assert boundary > paths(waves).boundary(0.02)


def test_a_wave_nobody_can_miss_overflows_nothing():
    assert paths(400 / np.sqrt(20) * different()).boundary(1e-3) >= 0


@pytest.mark.parametrize("block", [0, 7, 19])
def test_weights_are_those_of_a_density(block):
    """Whatever block they are taken at, they average to one: a mutual check of Shiryaev's recursion and the onsets to come."""
    assert paths(0.2 * different()).weight[:, block].mean() == pytest.approx(1.0, abs=0.02)
