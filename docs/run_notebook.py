"""Runs the cells of the notebooks in docs/tutorial and writes what they print and show: ``PYTHONPATH=. python docs/run_notebook.py``."""

from __future__ import annotations

import ast
import contextlib
import io
import json
from pathlib import Path
from typing import Any

NOTEBOOKS = sorted((Path(__file__).parent / "tutorial").glob("*.ipynb"))


def run(notebook: dict[str, Any]) -> list[list[dict[str, Any]]]:
    """Return the outputs of the code cells, in one namespace, as a notebook stores them."""
    place: dict[str, Any] = {"__name__": "__main__"}
    return [_outputs("".join(cell["source"]), place) for cell in notebook["cells"] if cell["cell_type"] == "code"]


def _outputs(source: str, place: dict[str, Any]) -> list[dict[str, Any]]:
    body, last, said = ast.parse(source), None, io.StringIO()
    if body.body and isinstance(body.body[-1], ast.Expr):
        last = ast.Expression(body.body.pop().value)  # type: ignore[attr-defined]
    with contextlib.redirect_stdout(said):
        exec(compile(body, "cell", "exec"), place)
        value = None if last is None else eval(compile(last, "cell", "eval"), place)
    found: list[dict[str, Any]] = []
    if said.getvalue():
        found.append({"name": "stdout", "output_type": "stream", "text": said.getvalue().splitlines(keepends=True)})
    if value is not None:
        shown = {"text/plain": repr(value).splitlines(keepends=True)}
        if hasattr(value, "_repr_html_"):
            shown["text/html"] = value._repr_html_().splitlines(keepends=True)
        found.append({"output_type": "execute_result", "execution_count": None, "metadata": {}, "data": shown})
    return found


if __name__ == "__main__":
    for path in NOTEBOOKS:
        notebook = json.loads(path.read_text(encoding="utf-8"))
        for cell, outputs in zip((c for c in notebook["cells"] if c["cell_type"] == "code"), run(notebook), strict=True):
            cell["outputs"] = outputs
        path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        print(path)
