"""Many recordings through one task: in parallel here or on a cluster, resumable, into one table.

Every recording's document is kept in a file of its own as soon as it is there; what is there is not computed again, so a run that was
killed goes on where it stopped. A recording that cannot be worked on is a row with its reason, and no other one suffers.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from joblib import Parallel, delayed, parallel_config

from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.files.open import Naming
from afdsvc.files.unfinished import writing
from afdsvc.files.validation import read_text

TASKS = ("diagnose", "identify", "explain")
COLUMNS = (
    ("recording", pa.string()), ("task", pa.string()), ("error", pa.string()), ("verdict", pa.string()), ("what", pa.string()),
    ("site", pa.string()), ("value", pa.float64()), ("sd", pa.float64()), ("seconds", pa.float64()), ("document", pa.string()),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Batch:
    """What is done to every recording: the task, the model where one is needed, the detectors `diagnose` is to use instead, the
    mapping file of recordings of others.
    """

    task: str
    model: Path | None = None
    detectors: tuple[str, ...] = ()
    allow_code: bool = False
    mapping: Path | None = None

    def __post_init__(self) -> None:
        if self.task not in TASKS:
            raise BadInput(f"task '{self.task}'; expected one of {', '.join(TASKS)}")
        if self.task == "identify" and self.model is None:
            raise BadInput("task 'identify' needs --model MODEL.toml")

    @property
    def naming(self) -> Naming:
        """What the columns and topics of recordings of others are."""
        return Naming.of(self.mapping)

    def document(self, recording: Path, folder: Path) -> Mapping[str, Any]:
        """Return the document of one recording; models and pages the task makes go into ``folder``."""
        if self.task == "diagnose":
            from afdsvc.app.diagnose import diagnose_recordings

            return diagnose_recordings([recording], self.model, detectors=self.detectors, naming=self.naming)
        if self.task == "identify":
            from afdsvc.app.identify import identify_files

            folder.mkdir(parents=True, exist_ok=True)
            return identify_files(self.model or Path(), [recording], [], folder / "identified.toml", {}, 0, naming=self.naming)
        from afdsvc.app.explain import ExplainOptions, explain_files

        options = ExplainOptions(out=folder, allow_code=self.allow_code, jobs=1, mapping_file=self.mapping)
        return explain_files(self.model or recording, [recording], (), options)


@dataclass(frozen=True, slots=True)
class BatchOutcome:
    """How a run of a batch ended: rows in the table, how many of them failed, how many were there from an earlier run."""

    table: Path
    rows: int
    failed: int
    kept: int


def run_batch(
    batch: Batch, recordings: Sequence[Path], out: Path, jobs: int = 2, cluster: str | None = None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> BatchOutcome:
    """Do what is missing, then write the table (Parquet) ``out``; parts are kept in the folder ``out`` + ``.parts``.

    ``cluster`` is the address of a Dask scheduler whose workers see the same files; without it ``jobs`` processes work here.
    """
    if not recordings:
        raise BadInput("no recording is given; expected at least one")
    parts = out.with_name(out.name + ".parts")
    parts.mkdir(parents=True, exist_ok=True)
    paths = {recording: parts / f"{_key(batch, recording)}.json" for recording in recordings}
    missing = [r for r, path in paths.items() if not path.exists()]
    kept = len(paths) - len(missing)
    with _backend(cluster):
        work = Parallel(n_jobs=None if cluster else jobs, return_as="generator_unordered")
        for number, _ in enumerate(work(delayed(_one)(batch, r, paths[r]) for r in missing), 1):
            progress(kept + number, len(paths))
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in paths.values()]
    _write(rows, out)
    return BatchOutcome(out, len(rows), sum(bool(row["error"]) for row in rows), kept)


@contextmanager
def _backend(cluster: str | None) -> Iterator[None]:
    if cluster is None:
        with nullcontext():
            yield
        return
    try:
        from dask.distributed import Client
    except ImportError:
        raise BadInput("--cluster needs the extra 'cluster': install afdsvc[cluster]") from None
    try:
        client = Client(cluster, timeout="10s")  # type: ignore[no-untyped-call, unused-ignore]
    except (OSError, TimeoutError) as error:
        raise BadInput(f"--cluster {cluster}: no Dask scheduler answers there ({error})") from None
    with client, parallel_config(backend="dask"):
        yield


def _key(batch: Batch, recording: Path) -> str:
    """Return a name that changes with the task, its options, and the recording's content as far as size and time tell."""
    try:
        stat = recording.stat()
    except OSError as error:
        raise BadInput(f"{recording}: cannot be read: {error.strerror}") from error
    said = [batch.task, str(batch.model), *batch.detectors, str(recording.resolve()), stat.st_size, stat.st_mtime_ns]
    if batch.mapping is not None:
        said.append(read_text(batch.mapping))
    return hashlib.sha256(json.dumps(said).encode()).hexdigest()[:24]


def _one(batch: Batch, recording: Path, path: Path) -> None:
    """Work on one recording and keep its row; whatever is wrong with it is in the row."""
    row: dict[str, Any] = {"recording": str(recording), "task": batch.task, "error": ""}
    try:
        found = dict(batch.document(recording, path.with_suffix("")))
        row |= {**_summary(batch.task, found), "document": json.dumps(found, default=str)}
    except AfdsvcError as error:
        row["error"] = str(error)
    except Exception as error:  # one recording must not end the others
        row["error"] = f"{type(error).__name__}: {error}"
    partial = path.with_suffix(f".{os.getpid()}")
    partial.write_text(json.dumps(row), encoding="utf-8")
    partial.replace(path)


def _summary(task: str, found: Mapping[str, Any]) -> dict[str, Any]:
    """Return the columns one looks at first."""
    if task == "diagnose":
        verdict = found["recordings"][0]["verdict"]
        severity = verdict["severity"] or {}
        said = "fault" if verdict["first_detected_s"] is not None else "no fault" if verdict["trustworthy"] else "not trustworthy"
        return {"verdict": said, "what": verdict["fault"], "value": severity.get("value"), "sd": severity.get("sd"),
                "seconds": verdict["first_detected_s"]}  # fmt: skip
    if task == "identify":
        return {"verdict": found["method"], "what": f"order {found['order']}", "value": _worst_r2(found)}
    first = (found["named"] or [{}])[0]
    return {"verdict": found["verdict"], "what": first.get("physics"), "site": first.get("site"), "value": first.get("weight")}


def _worst_r2(found: Mapping[str, Any]) -> float | None:
    return min((fit["after"]["r2"] for fit in found["fit"]["per_output"].values()), default=None)


def _write(rows: Sequence[Mapping[str, Any]], out: Path) -> None:
    schema = pa.schema(COLUMNS)
    table = pa.Table.from_pylist([{name: row.get(name) for name in schema.names} for row in rows], schema)
    partial = out.with_name(out.name + ".part")
    with writing(partial):
        pq.write_table(table, partial)
        partial.replace(out)
