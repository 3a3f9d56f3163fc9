"""The truths of the blind trials are frozen: what is to be found is not changed together with what finds it."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from pathlib import Path

import pytest

import afdsvc

PACKAGE = Path(afdsvc.__file__).parent
ROOT = PACKAGE.parent
TRUTH = ("trial/laws", "trial/field")
HASH = "923c9faa4c95f7f235fe047d0e43e0638d592dd9fbe354172c4bf8b2ee16fe9e"
MESSAGE = (
    f"the laws and machines of the blind trials ({', '.join(TRUTH)}) are not those this hash was taken of. They may not be changed in a "
    "commit that changes afdsvc/explain or afdsvc/plugins/physics. In a commit of its own, say why they change, set HASH to {now}, "
    "and draw a new seed for the published study."
)


def digest() -> str:
    """Return the SHA-256 over names and contents of every source file of the truths."""
    files = sorted(path for room in TRUTH for path in (PACKAGE / room).rglob("*.py"))
    parts = (f"{path.relative_to(PACKAGE).as_posix()}\0{path.read_text(encoding='utf-8')}\0" for path in files)
    return hashlib.sha256("".join(parts).encode()).hexdigest()


def git(*arguments: str) -> str:
    return subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=True).stdout


def test_laws_and_machines_are_those_of_the_hash() -> None:
    now = digest()
    assert now == HASH, MESSAGE.format(now=now)


def changed_together(log: str) -> list[str]:
    """Return the commits of a ``git log --name-only --format=%x00%h`` that touch both the truths and the engine."""
    both = []
    for entry in filter(None, log.split("\0")):
        commit, *paths = entry.split()
        truths = any(p.startswith(tuple(f"afdsvc/{room}/" for room in TRUTH)) for p in paths)
        if truths and any(p.startswith("afdsvc/explain/") for p in paths):
            both.append(commit)
    return both


@pytest.mark.skipif(not (ROOT / ".git").exists() or shutil.which("git") is None, reason="not a git checkout")
def test_no_commit_changes_the_truths_and_the_engine_together() -> None:
    here = Path(__file__).relative_to(ROOT).as_posix()
    begun = git("log", "--diff-filter=A", "--format=%H", "--", here).split()
    if begun:
        rooms = [f"afdsvc/{room}" for room in TRUTH]
        log = git("log", "--no-merges", "--name-only", "--format=%x00%h", f"{begun[-1]}..HEAD", "--", *rooms, "afdsvc/explain")
        assert changed_together(log) == []


def test_a_commit_that_changes_both_is_seen() -> None:
    log = "\0aaa\n\nafdsvc/trial/laws/field.py\nafdsvc/explain/x.py\n\0bbb\n\nafdsvc/trial/laws/field.py\n\0ccc\n\nafdsvc/explain/x.py\n"
    assert changed_together(log) == ["aaa"]
