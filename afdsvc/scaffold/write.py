"""Writing the package of a new plugin from its templates."""

from __future__ import annotations

import keyword
import re
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from afdsvc.errors import BadInput

KINDS = {
    "controller": "controllers", "detector": "detectors", "driver": "drivers", "fault": "faults", "notifier": "notifiers",
    "physics": "physics",
}  # fmt: skip


def write_plugin(kind: str, name: str, folder: Path) -> list[Path]:
    """Write ``folder/name`` and return its files; raises `BadInput` for a kind or name that cannot be, or a folder that is there."""
    if kind not in KINDS:
        raise BadInput(f"kind of plugin '{kind}'; expected one of {', '.join(KINDS)}")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or keyword.iskeyword(name):
        raise BadInput(f"plugin name '{name}'; expected small letters, digits and _, a letter first, and no word of Python")
    root = folder / name
    if root.exists():
        raise BadInput(f"{root}: exists already and is not overwritten")
    facts = {"name": name, "kind": kind, "family": KINDS[kind], "Class": "".join(part.title() for part in name.split("_"))}
    templates = Environment(loader=PackageLoader("afdsvc.scaffold"), undefined=StrictUndefined, keep_trailing_newline=True)
    pages = {
        "pyproject.toml": "pyproject.toml.j2", "README.md": "README.md.j2", f"{name}.py": f"{kind}.py.j2",
        f"tests/test_{name}.py": "test.py.j2",
    }  # fmt: skip
    return [_write(root / path, templates.get_template(template).render(facts)) for path, template in pages.items()]


def _write(path: Path, text: str) -> Path:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror}") from error
    return path
