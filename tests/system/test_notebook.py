"""The notebooks run, and what they show is what the build says."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import nbformat
import pytest

DOCS = Path(__file__).parents[2] / "docs"
_spec = importlib.util.spec_from_file_location("run_notebook", DOCS / "run_notebook.py")
assert _spec is not None
assert _spec.loader is not None
run_notebook = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(run_notebook)


def texts(notebook) -> list[list[str]]:
    outputs = [cell.outputs for cell in notebook.cells if cell.cell_type == "code"]
    return [["".join(o["text"] if "text" in o else o["data"]["text/plain"]) for o in some] for some in outputs]


@pytest.mark.parametrize("path", run_notebook.NOTEBOOKS, ids=lambda p: p.name)
def test_a_notebook_shows_what_it_computes_and_how_far_it_is(path):
    pytest.importorskip("xarray")
    notebook = nbformat.read(path, as_version=4)
    stored = texts(notebook)
    assert len(stored) > 3
    pictures = run_notebook.run(notebook)
    assert texts(notebook) == stored, "run PYTHONPATH=. python docs/run_notebook.py"
    progress = [p for p in pictures if "<progress" in p]
    assert any("round 1, screening 1 of" in p for p in progress)
    assert any('value="1.000"' in p for p in progress)
    assert pictures[pictures.index(progress[-1]) + 1] == ""  # the bar is gone at the end
