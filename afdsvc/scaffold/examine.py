"""Running the conformance suite on a plugin by the name of its package or entry point, or its folder."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

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
