"""ARCHITECTURE.md names packages, functions and calls that exist."""

from __future__ import annotations

import importlib
import inspect
import re
from functools import reduce
from itertools import pairwise
from pathlib import Path

import pytest

import afdsvc

ROOT = Path(afdsvc.__file__).parent
TEXT = (ROOT.parent / "ARCHITECTURE.md").read_text(encoding="utf-8")
JOURNEYS = TEXT if (ROOT / "explain" / "pipeline.py").exists() else TEXT.split("## A recording through explain")[0]
CALLS = [re.findall(r"`([\w.]+:[\w.]+)`", line) for line in JOURNEYS.splitlines() if "→" in line]
FILES = re.findall(r"`((?:\w+/)+(?:\w+\.\w+)?)`", TEXT)


def _found(name: str) -> object:
    module, path = name.split(":")
    return reduce(getattr, path.split("."), importlib.import_module(f"afdsvc.{module}"))


@pytest.mark.parametrize("names", CALLS, ids=lambda names: " ".join(names))
def test_every_call_of_a_journey_is_in_the_code(names: list[str]):
    assert len(names) > 1
    for caller, callee in pairwise(names):
        assert callable(_found(callee))
        assert re.search(rf"\b{re.split('[.:]', callee)[-1]}\b", inspect.getsource(_found(caller))), f"{caller} does not name {callee}"


def test_the_picture_names_every_package():
    picture = TEXT.split("```text")[1].split("```")[0]
    packages = {p.parent.name for p in ROOT.glob("*/__init__.py")}
    assert packages <= set(re.findall(r"\w+", picture))


def test_files_to_extend_are_there():
    there = [name for name in FILES if (ROOT / name).exists() or (ROOT.parent / name).exists()]
    assert len(FILES) > 8
    assert there == FILES
