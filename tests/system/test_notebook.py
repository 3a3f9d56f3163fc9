"""The notebooks run, and what they show is what the build says."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
_spec = importlib.util.spec_from_file_location("run_notebook", DOCS / "run_notebook.py")
assert _spec is not None
assert _spec.loader is not None
run_notebook = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(run_notebook)


def texts(outputs: list) -> list[str]:
    return ["".join(o["text"] if "text" in o else o["data"]["text/plain"]) for o in outputs]


@pytest.mark.parametrize("path", run_notebook.NOTEBOOKS, ids=lambda p: p.name)
def test_a_notebook_shows_what_it_computes(path):
    pytest.importorskip("xarray")
    notebook = json.loads(path.read_text(encoding="utf-8"))
    stored = [texts(cell["outputs"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert len(stored) > 3
    assert [texts(outputs) for outputs in run_notebook.run(notebook)] == stored, "run PYTHONPATH=. python docs/run_notebook.py"
