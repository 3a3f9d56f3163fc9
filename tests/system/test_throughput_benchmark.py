"""The throughput benchmark runs as its page says: every part prints a rate, and no process ends in a message."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ALONE = Path(__file__).parents[2] / "benchmarks" / "throughput" / "alone.py"


@pytest.mark.parametrize(("part", "blocks"), [("judge", 140), ("zenoh", 400)])
def test_a_part_prints_a_rate_and_ends_quietly(part, blocks):
    done = subprocess.run([sys.executable, str(ALONE), part, str(blocks)], capture_output=True, text=True, check=True)
    assert float(done.stdout) > 0
    assert done.stderr == ""
