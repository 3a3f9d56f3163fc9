"""Claims about detection name tests that exist; one of them had no home elsewhere."""

import re
from pathlib import Path

import numpy as np
import pytest

from afdsvc.excite.simulated_burst import simulate_burst
from afdsvc.plugins.detectors import PassiveCusumDesign
from afdsvc.testing.machines import bearing_problem

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "reference" / "detection-claims.md"


def test_every_test_named_on_the_page_exists():
    named = re.findall(r"`(tests/[\w/.]+)::(\w+)`", PAGE.read_text())
    assert len(named) > 30
    missing = [f"{path}::{name}" for path, name in named if f"def {name}(" not in (ROOT / path).read_text()]
    assert not missing


def test_what_the_page_calls_long_has_long_settings():
    for row in PAGE.read_text().splitlines():
        if "(long)" in row:
            paths = re.findall(r"`(tests/[\w/.]+)::", row)
            assert any("mark.long" in (ROOT / path).read_text() for path in paths)


@pytest.mark.parametrize("scale", [0.8, 1.25])
def test_between_bursts_noise_of_another_size_is_reported_and_not_alarmed(scale):
    problem = bearing_problem("lqg")
    v = np.random.default_rng(6).normal(size=(12_000, 2)) @ np.linalg.cholesky(problem.covariance).T
    record = simulate_burst(problem, np.zeros((len(v), 2)), v * np.array([scale, 1.0]))
    detector = PassiveCusumDesign().design(problem, {})
    state, found = detector.start(), []
    for block in record.blocks(1000):
        state, evidence = detector.step(state, block)
        found += evidence
    assert found
    assert not any(e.detected for e in found)
    assert "times the stated standard deviation" in found[0].reason
