"""The files of user code that may run on this computer without being asked again: each by its place and its SHA-256."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from afdsvc.errors import BadInput
from afdsvc.files.validation import BOUNDS, file_size


def sha256_of(path: Path) -> str:
    """Return the hash of a file; raises `BadInput` when it cannot be read."""
    file_size(path, BOUNDS.table)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def allow(path: Path) -> str:
    """Remember that this file may run as it is now, and return its hash; what it was before may not run any more."""
    digest = sha256_of(path)
    _keep([line for line in _lines() if line.partition("  ")[2] != _place(path)] + [f"{digest}  {_place(path)}"])
    return digest


def forget(path: Path) -> None:
    """Forget that a file may run."""
    _keep([line for line in _lines() if line.partition("  ")[2] != _place(path)])


def allowed(path: Path) -> bool:
    """Whether a file may run, and is what it was when that was said."""
    return path.is_file() and f"{sha256_of(path)}  {_place(path)}" in _lines()


def _list() -> Path:
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "afdsvc" / "allowed-code"


def _place(path: Path) -> str:
    return str(path.resolve())


def _lines() -> list[str]:
    try:
        return _list().read_text().splitlines()
    except (OSError, RuntimeError):  # no such file, or nobody's home
        return []


def _keep(lines: list[str]) -> None:
    path = _list()
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        path.write_text("".join(f"{line}\n" for line in lines))
        path.chmod(0o600)
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror}") from None
