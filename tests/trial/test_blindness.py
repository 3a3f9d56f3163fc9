"""The room imports nothing that it is to judge."""

from __future__ import annotations

import ast
from pathlib import Path

import afdsvc.trial

ALLOWED = {"api", "dataset", "errors", "lti", "plants", "stats", "trial"}


def test_trial_imports_neither_hypotheses_nor_the_simulator_of_the_product() -> None:
    folder = Path(afdsvc.trial.__file__).parent
    rooms = set()
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
            rooms |= {name.split(".")[1] for name in names if name.startswith("afdsvc.")}
    assert rooms <= ALLOWED
    assert "trial" in rooms
