"""From files to an explanation: model and recordings in; improved model, page, Rerun file and document out."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from afdsvc import is_compiled
from afdsvc.api.model import Model
from afdsvc.api.physics import Physics
from afdsvc.api.signals import Trace
from afdsvc.errors import BadInput
from afdsvc.explain.pipeline import explain
from afdsvc.explain.report.explanation import Explanation
from afdsvc.files.model.improved import write_improved
from afdsvc.files.model.stepped import LINEARISED, REST
from afdsvc.files.open import Naming, OpenFile, OwnRecording, open_file, open_model
from afdsvc.files.tables.foreign import prepared
from afdsvc.files.tables.tables import PREPARED
from afdsvc.files.unfinished import writing
from afdsvc.plants.stepped.linearise import linearisation_notes
from afdsvc.plugins.manager import load

WRITTEN = ("MODEL.toml", "MODEL.py", "report.html")
REST_SECONDS = 0.1  # before a burst, for the loop to be simulated from
Progress = Callable[[str, float | None], None]


@dataclass(frozen=True, slots=True)
class ExplainOptions:
    """How `explain_files` goes about it: where files go, column names by foreign name, whether a model's code may run.

    ``rerun`` is the Rerun file to write (None: none), ``machine`` the one meant in recordings of several, ``jobs`` how many
    cores are used, ``mapping_file`` the mapping of recordings of others. ``trust_units`` makes warnings of what looks like wrong
    units or signs.
    """

    out: Path | None = None
    mapping: Mapping[str, str] = field(default_factory=dict)
    allow_code: bool = False
    rerun: Path | None = None
    machine: str | None = None
    jobs: int = 2
    mapping_file: Path | None = None
    trust_units: bool = False


def explain_files(
    model: Path, recordings: Sequence[Path], holdout: Sequence[Path] = (), options: ExplainOptions | None = None,
    progress: Progress = lambda what, share: None,
) -> dict[str, Any]:
    """Explain from files; writes the improved model, the page and, if asked, a Rerun file, and returns ``explain --json``.

    ``model`` is a MODEL.toml, or a recording of the service, whose own model is taken; without ``recordings`` that recording
    is explained. Raises `BadInput` naming the file and what is wrong with it.
    """
    options = options or ExplainOptions()
    nominal, beside = open_model(model, options.allow_code, options.machine)
    files: Sequence[Path | OpenFile] = recordings or ([beside] if beside else [])
    if not files:
        raise BadInput(f"{model}: no recording is given to explain; expected at least one")
    train, held = (from_rest(traces(paths, nominal, options), nominal) for paths in (files, holdout))
    folder = options.out or model.with_name(f"{model.stem}.explained")
    with writing(folder, *(folder / name for name in WRITTEN)):
        _make(folder)
        announce_compilation(progress)
        found = explain(nominal, train, held, load_library(), mapper=parallel(options.jobs), progress=progress, trust_units=options.trust_units)
        unit = [*nominal.extra.get(LINEARISED, ()), *linearisation_notes(nominal, [*train, *held])]
        found = replace(found, check=(*unit, *found.check), notes={**found.notes, "data": prepared([*train, *held])})
        return _written(found, nominal, folder, aux_means([*train, *held]), options)


def traces(paths: Sequence[Path | OpenFile], model: Model, options: ExplainOptions) -> list[Trace]:
    """Return every gapless piece of the files, with the model's units, each under a name of its own."""
    found: list[Trace] = []
    naming = Naming.of(options.mapping_file, options.mapping)
    for path in paths:
        pieces = _pieces(open_file(path, naming) if isinstance(path, Path) else path, model, options.machine)
        found += [_named(t, f"{t.name} ({k})" if len(pieces) > 1 else t.name, found) for k, t in enumerate(pieces, 1)]
    return found


def from_rest(pieces: Sequence[Trace], model: Model) -> list[Trace]:
    """Return the traces as deviations from where a simulator that only steps rests; as they are for other models."""
    rest = {f"y_{v.name}": y for v, y in zip(model.outputs, model.extra.get(REST, ()), strict=False) if y}
    if not rest:
        return list(pieces)
    shift = np.array([rest.get(c.name, 0.0) for c in pieces[0].channels]) if pieces else np.zeros(0)
    said = [f"{value:g} is taken off {name}, where the simulator rests" for name, value in rest.items()]
    return [
        replace(t, values=t.values - shift, notes={**t.notes, PREPARED: "\n".join([*t.notes.get(PREPARED, "").splitlines(), *said])})
        for t in pieces
    ]


def _pieces(file: OpenFile, model: Model, machine: str | None) -> list[Trace]:
    """Return the bursts of a recording of the service, each with a moment of rest before it; everything where there is none.

    Missing samples of a table become gaps.
    """
    if not isinstance(file, OwnRecording):
        return file.traces(model, gaps=True)
    found, bursts = file.traces_and_bursts(model, machine)
    pieces = []
    for t in found:
        first = int(t.notes.get("k0", 0))
        inside = [(a - first, b - first) for session, a, b in bursts if session == t.notes.get("session") and first <= a < first + len(t)]
        rest = round(REST_SECONDS / t.dt)
        pieces += [t.span(max(a - rest, 0), min(b, len(t))) for a, b in inside]
    return pieces or found


def _named(trace: Trace, name: str, others: Iterable[Trace]) -> Trace:
    taken = {t.name for t in others}
    number = next(k for k in range(1, 10000) if (name if k == 1 else f"{name} #{k}") not in taken)
    return replace(trace, name=name if number == 1 else f"{name} #{number}")


def load_library() -> list[Physics]:
    """Return every hypothesis plugin that is installed."""
    return [offer.thing for offer in load().offers if offer.family == "physics"]


def parallel(jobs: int) -> Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]:
    """Return a map over this many threads (the simulations run outside Python's lock), in order as they come; the plain one for a single job.

    A map within a map runs in the thread it is in. Raises `BadInput` for less than one job.
    """
    if jobs < 1:
        raise BadInput(f"jobs: found {jobs}; expected 1 or more")
    if jobs == 1:
        return map
    pool, here = ThreadPoolExecutor(jobs, "explain"), threading.local()

    def mapper(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterable[Any]:
        def within(item: Any) -> Any:
            here.within = True
            return function(item)

        return map(function, items) if getattr(here, "within", False) else pool.map(within, items)

    return mapper


def aux_means(recordings: Sequence[Trace]) -> dict[str, float]:
    """Return the mean of every auxiliary signal over the recordings, sorted by name."""
    labels = sorted({c.label for t in recordings for c in t.channels if c.role == "aux"})
    return {
        label: float(np.nanmean(np.concatenate([t.column(f"aux_{label}") for t in recordings if t.has(f"aux_{label}")])))
        for label in labels
    }


def announce_compilation(progress: Progress) -> None:
    """Say so where the simulation is not compiled yet: that takes a minute, once on a computer."""
    if not is_compiled():
        progress("compiling the simulation, once on this computer", 0.0)


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"--out {folder}: no such folder can be made: {error.strerror or error}") from None


def _written(
    found: Explanation, nominal: Model, folder: Path, aux: Mapping[str, float], options: ExplainOptions
) -> dict[str, Any]:
    from afdsvc.present.html.explain_page import explain_page  # imports matplotlib

    target, page = folder / WRITTEN[0], folder / WRITTEN[2]
    if nominal.origin and Path(nominal.origin).resolve() == target.resolve():
        raise BadInput(f"--out {folder}: the nominal model would be overwritten; expected another folder")
    written = write_improved(found, target, aux)
    document = found.json(str(target), str(page))
    document["files"] = [str(path) for path in written]
    page.write_text(explain_page(found, document), encoding="utf-8")
    if options.rerun:
        from afdsvc.present.rerun.explained import log_explanation

        log_explanation(found, options.rerun)
        document["rerun"] = str(options.rerun)
    return document
