"""The code on the explanation page runs, top to bottom, and the names in its text exist."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "explanation" / "retuning.md"


def test_every_block_of_the_page_runs() -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    assert len(blocks) >= 4
    names: dict[str, object] = {}
    for number, block in enumerate(blocks, 1):
        exec(compile(block, f"{PAGE.name}, block {number}", "exec"), names)


def test_every_name_in_the_text_exists() -> None:
    for name in set(re.findall(r"`(afdsvc(?:\.\w+)+)`", PAGE.read_text(encoding="utf-8"))):
        parent, _, last = name.rpartition(".")
        assert hasattr(import_module(parent), last), name
