"""Writing a study as a Markdown page with pictures, date and command."""

from __future__ import annotations

import datetime
import platform
from pathlib import Path

from matplotlib.figure import Figure

DOCS = Path(__file__).resolve().parents[2] / "docs"


def picture(figure: Figure, name: str) -> str:
    """Save a figure under docs/pictures and return the Markdown that shows it from docs/reference."""
    folder = DOCS / "pictures"
    folder.mkdir(exist_ok=True)
    figure.savefig(folder / f"{name}.png", dpi=110)
    return f"![{name}](../pictures/{name}.png)"


def table(header: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def write(name: str, title: str, command: str, parts: list[str]) -> None:
    """Write docs/reference/<name>.md."""
    stamp = f"Written {datetime.date.today().isoformat()} by `{command}` (Python {platform.python_version()}, {platform.machine()})."
    path = DOCS / "reference" / f"{name}.md"
    path.parent.mkdir(exist_ok=True)
    path.write_text("\n\n".join([f"# {title}", stamp, *parts]) + "\n")
    print(f"wrote {path}")
