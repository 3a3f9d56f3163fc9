"""The package of a new plugin, written from templates, and the conformance suite run on an installed one or on a folder."""

from __future__ import annotations

import importlib
import keyword
import re
import sys
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from afdsvc.errors import BadInput
from afdsvc.plugins.manager import Plugins, load
from afdsvc.testing.conformance import examine


def examine_package(package: str) -> list[dict[str, Any]]:
    """Return one row per check of everything a package offers; raises `BadInput` when it cannot be loaded or offers nothing."""
    found, name = _found(package)
    offers = [o for o in found.offers if o.plugin == name]
    if name in found.broken:
        raise BadInput(f"plugin '{name}' did not load: {found.broken[name]}")
    if not offers:
        raise BadInput(f"plugin '{name}' offers nothing; expected a function marked with @hookimpl, such as afdsvc_detectors")
    return [
        {"family": o.family, "name": o.name, "check": r.check, "asked": r.asked, "failure": r.failure}
        for o in offers
        for r in examine(o.family, o.thing)
    ]


def _found(package: str) -> tuple[Plugins, str]:
    installed = load()
    if package in installed.broken or any(o.plugin == package for o in installed.offers):
        return installed, package
    module = _imported(package)
    return load(extra=[module], discover=False), str(module.__name__)


def _imported(package: str) -> Any:
    """Import a module by name, or the one module in a folder."""
    folder = Path(package)
    name = package
    if folder.is_dir():
        name = folder.resolve().name
        sys.path.insert(0, str(folder.resolve()))
    try:
        return importlib.import_module(name)
    except Exception as error:
        raise BadInput(f"{package}: cannot be imported as a plugin ({type(error).__name__}: {error})") from error


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
    templates = Environment(loader=PackageLoader("afdsvc.testing"), undefined=StrictUndefined, keep_trailing_newline=True)
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
