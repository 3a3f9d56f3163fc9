"""Blind trials on disk: recordings are made and sealed, `explain` sees the files alone, then the seal is broken and scored."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from afdsvc.app.explain import ExplainOptions, load_library, traces
from afdsvc.errors import BadInput
from afdsvc.explain.pipeline import explain
from afdsvc.files.model.model_file import read_model
from afdsvc.trial.pages import markdown, page, summary
from afdsvc.trial.study import FIELD, MIX, Request, Result, field_plan, plan, refusals, study, write_only

LARGE = 1200  # trials of the plan that kinds are picked from


def trial_files(
    folder: Path, count: int, seed: int, rho: float | None = None, kinds: Sequence[str] = (), parts: Sequence[str] = (),
    jobs: int = 1, keep: bool = False, progress: Callable[[int, int], None] = lambda done, all: None, only_write: bool = False,
) -> dict[str, Any]:
    """Run the blind trials that are not in ``folder`` yet and write the report there, as markdown and HTML.

    ``rho`` sets the severity of what is hidden; ``kinds`` asks for trials that hide one of these names ("nothing" too),
    ``parts`` for those of some parts of the plan. A run that was interrupted goes on where it stopped. With ``only_write``,
    recordings and sealed answers are written and nothing is explained. Raises `BadInput` when no trial is left, or the folder
    holds another study.
    """
    requests = in_order(count, seed, rho, kinds, parts)
    if only_write:
        places = write_only(requests, folder, jobs, progress)
        return {"trials": len(places), "summary": f"{len(places)} trials written, none explained", "refused": refusals(folder), "folder": str(folder)}
    done = study(requests, from_files, folder, jobs, keep, progress)
    return write_reports(done, folder)


def in_order(count: int, seed: int, rho: float | None, kinds: Sequence[str], parts: Sequence[str]) -> list[Request]:
    """Return the requests of a study as they are run, shuffled: what is done when it is interrupted is a fair sample."""
    requests = study_requests(count, seed, rho, kinds, parts)
    np.random.default_rng(seed).shuffle(requests)
    return requests


def study_requests(count: int, seed: int, rho: float | None, kinds: Sequence[str], parts: Sequence[str]) -> list[Request]:
    """Return the requests of a study; raises `BadInput` naming the kind or part that no trial contains.

    With ``kinds`` or ``parts``, ``count`` trials of those are picked evenly from a larger plan.
    """
    if count < 1:
        raise BadInput(f"--n {count}: expected a number above 0")
    for part in parts:
        if part not in (*MIX, FIELD):
            raise BadInput(f"--parts {part}: expected one of {', '.join((*MIX, FIELD))}")
    requests = field_plan(count, seed) if set(parts) == {FIELD} else plan(count, seed)
    if kinds or set(parts) - {FIELD}:
        large = plan(max(LARGE, count), seed)
        if FIELD in parts:
            large += [replace(r, number=len(large) + r.number) for r in field_plan(max(LARGE, count), seed)]
        _check_kinds(kinds, large)
        fitting = [r for r in large if (not parts or r.part in parts) and (not kinds or set(_names(r)) & set(kinds))]
        requests = [fitting[k * len(fitting) // count] for k in range(count)] if count < len(fitting) else fitting
    if not requests:
        raise BadInput("no trial of these --parts hides one of these --kinds; expected others")
    if rho is None:
        return requests
    if not rho > 0:
        raise BadInput(f"--rho {rho:g}: expected a number above 0")
    return [replace(r, wishes=tuple(replace(w, rho=rho) for w in r.wishes)) for r in requests]


def _check_kinds(kinds: Sequence[str], requests: Sequence[Request]) -> None:
    names = {name for r in requests for name in _names(r)}
    for kind in kinds:
        if kind not in names:
            raise BadInput(f"--kinds {kind}: expected one of {', '.join(sorted(names))}")


def _names(request: Request) -> list[str]:
    return [w.physics.partition(":")[0] for w in request.wishes] or ["nothing"]


def from_files(model: Path, recordings: Sequence[Path], holdout: Path) -> Mapping[str, Any]:
    """Return the document of ``explain --json`` for the files of a trial, without a next experiment: nothing but files is
    handed over."""
    options = ExplainOptions(jobs=1, allow_code=True)  # the code of a nominal model comes from the generator
    nominal = read_model(model, options.allow_code)
    train, held = (traces(paths, nominal, options) for paths in (recordings, [holdout]))
    return explain(nominal, train, held, load_library(), experiment=False).json(None, None)


def write_reports(done: Sequence[Result], folder: Path) -> dict[str, Any]:
    """Write both reports into the folder; returns their paths and the summary."""
    words, table = folder / "blind-trials.md", folder / "blind-trials.html"
    words.write_text(markdown(done), encoding="utf-8")
    table.write_text(page(done), encoding="utf-8")
    return {
        "trials": len(done), "summary": summary(done), "refused": refusals(folder), "markdown": str(words), "html": str(table),
        "folder": str(folder),
    }
