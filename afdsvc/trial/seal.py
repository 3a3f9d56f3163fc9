"""Sealing an answer: a commitment goes with the recordings, the answer itself is kept apart until it is opened.

The commitment is the SHA-256 of a random nonce, the answer and the digests of the trial's files. Whoever holds the folder
cannot read the answer out of it; whoever holds the answer cannot change it, or the recordings, afterwards.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from pathlib import Path
from typing import Any

from afdsvc.errors import BadInput, Refused
from afdsvc.trial.answer import TrialAnswer
from afdsvc.trial.field.answer import FieldAnswer
from afdsvc.trial.folder import TrialPaths

SEAL = "SEAL.json"


def seal(answer: TrialAnswer | FieldAnswer, paths: TrialPaths, vault: str | Path) -> Path:
    """Write the commitment beside the model and the answer into the vault (another folder); return the answer's path.

    Raises `BadInput` when the vault lies inside the trial's folder.
    """
    folder, vault = paths.model.parent.resolve(), Path(vault).resolve()
    if vault == folder or folder in vault.parents:
        raise BadInput(f"{vault}: lies inside the trial's folder {folder}; a folder outside is wanted")
    vault.mkdir(parents=True, exist_ok=True)
    files = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths.all}
    sealed = {"nonce": secrets.token_hex(32), "answer": answer.as_json(), "files": files}
    commitment = {"algorithm": "sha256", "commitment": _digest(sealed)}
    (folder / SEAL).write_text(json.dumps(commitment, indent=1), encoding="utf-8")
    kept = vault / f"{folder.name}.json"
    kept.write_text(json.dumps(sealed, indent=1), encoding="utf-8")
    return kept


def open_seal(folder: str | Path, kept: str | Path) -> TrialAnswer | FieldAnswer:
    """Return the answer of a trial; raises `Refused` when answer, recordings and commitment do not belong together."""
    folder, kept = Path(folder), Path(kept)
    sealed, commitment = _table(kept), _table(folder / SEAL)
    if _digest(sealed) != commitment.get("commitment"):
        raise Refused(f"{kept}: is not the answer that was sealed with {folder}")
    for name, digest in sealed["files"].items():
        path = folder / name
        if not path.exists() or hashlib.sha256(path.read_bytes()).hexdigest() != digest:
            raise Refused(f"{path}: is not the file that was sealed")
    return answer_of(sealed["answer"])


def answer_of(table: dict[str, Any]) -> TrialAnswer | FieldAnswer:
    """Return the answer of a trial of either sort from plain values."""
    return FieldAnswer.from_json(table) if "family" in table else TrialAnswer.from_json(table)


def _digest(sealed: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(sealed, sort_keys=True).encode()).hexdigest()


def _table(path: Path) -> dict[str, Any]:
    try:
        table: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BadInput(f"{path}: cannot be read as a seal: {error}") from None
    return table
