"""Runs the notebooks in docs/tutorial in a kernel and writes what they print and show: ``PYTHONPATH=. python docs/run_notebook.py``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parent / "tutorial").glob("*.ipynb"))


class Client(NotebookClient):  # type: ignore[misc]
    """Runs a notebook and keeps every picture that was shown for a while, such as progress."""

    def __init__(self, notebook: Any) -> None:
        super().__init__(notebook, timeout=900, kernel_name="python3", record_timing=False)
        self.pictures: list[str] = []

    def process_message(self, msg: Any, cell: Any, cell_index: int) -> Any:
        """Take a message of the kernel."""
        if msg["msg_type"] in ("display_data", "update_display_data"):
            self.pictures.append(msg["content"]["data"].get("text/html", ""))
        return super().process_message(msg, cell, cell_index)


def run(notebook: Any) -> list[str]:
    """Run the cells, keep their outputs in the notebook, and return what was shown on the way."""
    client = Client(notebook)
    client.execute()
    notebook.metadata.language_info = {"name": "python"}  # without the version it ran with
    for cell in notebook.cells:
        if cell.cell_type == "code":  # what is gone at the end, and how many runs there were, are not results
            cell.execution_count = None
            cell.outputs = [kept for kept in cell.outputs if kept.get("data", {}).get("text/plain", "-")]
    return client.pictures


if __name__ == "__main__":
    for path in NOTEBOOKS:
        notebook = nbformat.read(path, as_version=4)
        run(notebook)
        nbformat.write(notebook, path)
        print(path)
