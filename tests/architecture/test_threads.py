"""A process that imports the package runs its linear algebra in one thread, with nothing exported."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

TASKS = Path("/proc/self/task")
PRODUCT = f"import afdsvc.lti, numpy, pathlib; numpy.ones((600, 600)) @ numpy.ones((600, 600)); print(len(list(pathlib.Path('{TASKS}').iterdir())))"


@pytest.mark.skipif(not TASKS.is_dir(), reason="threads of a process are counted in /proc")
def test_linear_algebra_has_one_thread():
    clean = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", PRODUCT], env=clean, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "1"
