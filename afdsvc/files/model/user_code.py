"""The Python simulator that a MODEL.toml may name: foreign code, run only with the user's permission."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from afdsvc.api.model import Dynamics
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import StateSpace

TRUSTED = "AFDSVC_TRUSTED"


def load_dynamics(reference: str, source: str, allow_code: bool) -> Dynamics:
    """Return the object ``file.py:name``, relative to the model; raises `BadInput` naming what is not there."""
    refuse_code(reference, source, allow_code)
    file, name = reference.rsplit(":", 1)
    found = load_code(reference, Path(source).parent, f"{source}: key 'dynamics'")
    missing = [method for method in "fh" if not callable(getattr(found, method, None))]
    if missing:
        wanted = "expected f(t, x, u, p) and h(t, x, u, p)"
        raise BadInput(f"{source}: key 'dynamics' names {Path(source).parent / file}, where '{name}' has no {' and no '.join(missing)}; {wanted}")
    return cast(Dynamics, found)


def refuse_code(reference: str, source: str, allow_code: bool, key: str = "") -> None:
    """Raise `BadInput` when code would run without permission: the one gate in front of all code that a file names.

    ``source`` is the file that must lie in a trusted folder, ``key`` (the file's key ``dynamics`` by default) is for the sentence.
    """
    if not allow_code and not _trusted(Path(source)):
        kind = "compiled code" if reference.endswith(".fmu") else "Python code"
        where = key or f"{source}: key 'dynamics'"
        raise BadInput(
            f"{where} is '{reference}', {kind} that would run on this computer; "
            f"expected permission to run code: --allow-code (allow_code=True), or a folder named in {TRUSTED}"
        )


def load_code(reference: str, folder: Path, key: str) -> Any:
    """Return the object ``file.py:name`` (relative to the folder) or ``package.module:name``; raises `BadInput`.

    ``key`` says where the reference stands, for the sentence. Callers pass `refuse_code` first.
    """
    place, _, name = reference.rpartition(":")
    if not place or not name.isidentifier():
        raise BadInput(f"{key} is '{reference}'; expected file.py:name or package.module:name")
    if place.endswith(".py"):
        where = f"{key} names {folder / place}"
        module = _run(folder / place, where)
    else:
        where = f"{key} names the module {place}"
        module = _imported(place, where)
    found = getattr(module, name, None)
    if found is None:
        raise BadInput(f"{where}, which defines no '{name}'")
    return found


def _imported(place: str, where: str) -> ModuleType:
    try:
        return importlib.import_module(place)
    except Exception as error:
        raise BadInput(f"{where}, which cannot be imported: {type(error).__name__}: {error}") from error


def _trusted(path: Path) -> bool:
    """Return whether a file lies in one of the folders of the environment variable `TRUSTED` (separated as in PATH).

    A model inside a recording is no file of its own and never trusted.
    """
    folders = [Path(f).resolve() for f in os.environ.get(TRUSTED, "").split(os.pathsep) if f]
    return path.is_file() and any(folder in path.resolve().parents for folder in folders)


def offered_linear_part(dynamics: Dynamics) -> StateSpace | None:
    """Return the plant a simulator offers as ``linear`` (A, B, C, D, sample time): itself without what is not linear.

    Terms left out are set to zero, not linearised: friction and backlash have no useful slope at rest.
    """
    offered = getattr(dynamics, "linear", None)
    if offered is None:
        return None
    A, B, C, D, dt = offered
    return StateSpace.of(A, B, C, D, dt)


def _run(path: Path, where: str) -> ModuleType:
    if not path.is_file():
        raise BadInput(f"{where}, which does not exist")
    label = f"afdsvc_model_{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]}"
    spec = importlib.util.spec_from_file_location(label, path)
    if spec is None or spec.loader is None:
        raise BadInput(f"{where}, which is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[label] = module  # dataclasses and pickles look their module up here
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[label]
        raise BadInput(f"{where}, which fails with {type(error).__name__}: {error}") from error
    return module
