"""The files of commit 09e6b58 in a folder of their own, and the command line that works on them with one arithmetic everywhere."""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import pytest

HERE = Path(__file__).parent
FILES, SHIPPED = HERE / "09e6b58", HERE.parents[1] / "recordings" / "shipped"
AFDSVC = [sys.executable, "-m", "afdsvc"]
# Kernels that are chosen by the processor differ in the last bits; these run on every x86-64 processor of the last ten years.
PINNED = {
    "OPENBLAS_NUM_THREADS": "1", "OPENBLAS_CORETYPE": "Haswell", "NUMBA_CPU_NAME": "generic",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
}  # fmt: skip


def libraries() -> dict[str, str]:
    """Return what else decides the last bits of a result: the processor's family and the versions of the libraries that compute."""
    return {"machine": platform.machine()} | {name: version(name) for name in ("numpy", "scipy", "numba")}


def run(command: str, folder: Path, arithmetic: dict[str, str] = PINNED) -> str:
    """Return what a command prints on stdout, run in a folder; raises CalledProcessError when it fails."""
    line = [*AFDSVC, *command.split()]
    return subprocess.run(line, cwd=folder, env=os.environ | arithmetic, stdout=subprocess.PIPE, text=True, timeout=240, check=True).stdout


def laid_out(folder: Path) -> Path:
    """Return a new folder with the files of the commit, one recording that was torn while it was written, and the site with a certain
    model: that commit's `design` took no account of a stated uncertainty."""
    shutil.copytree(FILES, folder)
    model, site = (folder / "stated.toml").read_text(), (folder / "site.toml").read_text()
    (folder / "certain.toml").write_text(model.replace("[uncertainty]\nrelative = 0.02\nB = [[0], [200.0]]\n", ""))
    (folder / "certain_site.toml").write_text(site.replace("stated.toml", "certain.toml"))
    (folder / "torn.mcap").write_bytes((folder / "recording.mcap").read_bytes()[:100_000])
    return folder


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """Return the folder of the files."""
    return laid_out(tmp_path / "files")


@pytest.fixture(name="run")
def _run() -> Callable[..., str]:
    """Return `run`."""
    return run


@pytest.fixture
def same_libraries() -> bool:
    """Whether the libraries are those the documents were made with."""
    return json.loads((FILES / "libraries.json").read_text()) == libraries()
