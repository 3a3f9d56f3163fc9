"""A study: many trials through one `explain`, resumable, each result kept in a file of its own."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

from afdsvc.errors import BadInput, Refused
from afdsvc.trial.answer import TrialAnswer
from afdsvc.trial.field.answer import FieldAnswer
from afdsvc.trial.field.generate import FieldTrial
from afdsvc.trial.folder import TrialPaths, write
from afdsvc.trial.generate import BlindTrial
from afdsvc.trial.plan import Request, make_trial
from afdsvc.trial.scoring.field_score import field_oracle, field_score
from afdsvc.trial.scoring.oracle import Oracle, oracle
from afdsvc.trial.scoring.rival import rival_distance
from afdsvc.trial.scoring.score import score
from afdsvc.trial.seal import answer_of, open_seal, seal

Explain = Callable[[Path, tuple[Path, ...], Path], Mapping[str, Any]]
Result = dict[str, Any]


def study(
    requests: Sequence[Request], explain: Explain, folder: str | Path, jobs: int = 1, keep: bool = False,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> list[Result]:
    """Return the results of all requests, running those that are not in ``folder`` yet, ``jobs`` at a time.

    ``explain(model, recordings, holdout)`` gets paths and returns the document of `explain --json`; an exception it raises
    is a result too. Recordings are removed after scoring unless ``keep`` is True. A study that was interrupted goes on where
    it stopped when it is called again with the same folder. ``progress`` is told how many of all are done. A trial whose laws fit
    no machine that is drawn is left out; `refusals` says why.
    """
    folder = _opened(requests, Path(folder))
    missing = [r for r in requests if not (_result_path(folder, r.number).exists() or _refusal_path(folder, r.number).exists())]
    already = len(requests) - len(missing)
    for count, _ in enumerate(_run(missing, explain, folder, keep, jobs), already + 1):
        progress(count, len(requests))
    return results(folder)


def _opened(requests: Sequence[Request], folder: Path) -> Path:
    """Make the folders of a study and return the outermost; raises `BadInput` when it holds another study."""
    for name in ("trials", "sealed", "results", "refused"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    _same_study(requests, folder)
    return folder


def _run(missing: Sequence[Request], explain: Explain, folder: Path, keep: bool, jobs: int) -> Iterable[None]:
    run = partial(_run_or_refused, explain=explain, folder=folder, keep=keep)
    if jobs <= 1:
        return map(run, missing)
    done: Iterable[None] = Parallel(n_jobs=jobs, return_as="generator_unordered")(delayed(run)(r) for r in missing)
    return done


def _run_or_refused(request: Request, explain: Explain, folder: Path, keep: bool) -> None:
    with _refusal_kept(request, folder):
        run_one(request, explain, folder, keep)


@contextmanager
def _refusal_kept(request: Request, folder: Path) -> Iterator[None]:
    """Keep why a trial cannot be made."""
    try:
        yield
    except Refused as error:
        _write_whole(_refusal_path(folder, request.number), {"number": request.number, "why": str(error)})


def refusals(folder: str | Path) -> list[str]:
    """Return why trials of a study were left out, by number."""
    return [json.loads(path.read_text(encoding="utf-8"))["why"] for path in sorted((Path(folder) / "refused").glob("*.json"))]


def results(folder: str | Path) -> list[Result]:
    """Return the results that are in the folder of a study, by number."""
    paths = sorted((Path(folder) / "results").glob("*.json"))
    return [json.loads(path.read_text(encoding="utf-8")) for path in paths]


def run_one(request: Request, explain: Explain, folder: Path, keep: bool) -> Result:
    """Make, seal, explain, open and score one trial; keep its result and return it."""
    trial, paths, kept = _sealed(request, folder)
    explanation, seconds = _explained(explain, paths)
    answer, best = open_seal(paths.model.parent, kept), _best(trial)
    result = {
        "number": request.number, "part": request.part, "answer": answer.as_json(), "explanation": explanation,
        "oracle": asdict(best), "seconds": seconds, "score": _scored(explanation, answer, best),
    }
    result["apart"] = _apart(trial, result)
    _write_whole(_result_path(folder, request.number), result)
    if not keep:
        shutil.rmtree(paths.model.parent)
    return result


def write_only(
    requests: Sequence[Request], folder: str | Path, jobs: int = 1, progress: Callable[[int, int], None] = lambda done, of: None
) -> list[Path]:
    """Write the recordings of all requests into ``folder/trials`` and the sealed answers into ``folder/sealed``; explain nothing.

    Returns the folders of the trials. Trials that are there already are made again, the same. Another engine's documents, one per
    trial, are scored by `study` with the same requests and folder and an ``explain`` that returns them.
    """
    folder = _opened(requests, Path(folder))
    made = Parallel(n_jobs=jobs, return_as="generator_unordered")(delayed(_written)(r, folder) for r in requests)
    for count, _ in enumerate(made, 1):
        progress(count, len(requests))
    return [_place(folder, r) for r in requests if _place(folder, r).exists()]


def _written(request: Request, folder: Path) -> None:
    with _refusal_kept(request, folder):
        _sealed(request, folder)


def _sealed(request: Request, folder: Path) -> tuple[BlindTrial | FieldTrial, TrialPaths, Path]:
    """Make, write and seal one trial; field trials are written as text, as their owners would bring them."""
    place = _place(folder, request)
    shutil.rmtree(place, ignore_errors=True)
    trial = make_trial(request)
    paths = write(trial, place, "csv" if isinstance(trial, FieldTrial) else "npz")
    return trial, paths, seal(trial.answer, paths, folder / "sealed")


def _place(folder: Path, request: Request) -> Path:
    return folder / "trials" / f"{request.number:04d}"


def _best(trial: BlindTrial | FieldTrial) -> Oracle:
    return field_oracle(trial) if isinstance(trial, FieldTrial) else oracle(trial)


def _scored(explanation: Mapping[str, Any], answer: TrialAnswer | FieldAnswer, best: Oracle) -> dict[str, Any]:
    if isinstance(answer, FieldAnswer):
        return field_score(explanation, answer, best).as_json()
    return score(explanation, answer, best).as_json()


def rescored(result: Mapping[str, Any]) -> Result:
    """Return a kept result scored anew."""
    answer, best = answer_of(result["answer"]), Oracle(**result["oracle"])
    return {**result, "score": _scored(result["explanation"], answer, best)}


def _apart(trial: BlindTrial | FieldTrial, result: Result) -> float | None:
    """Return how far apart, for this data, the first name and what was hidden are; None where the first name is not wrong."""
    named = result["explanation"].get("named", [])
    if isinstance(trial, FieldTrial) or result["score"]["first"] is not False or not named or len(trial.truth.effects) != 1:
        return None
    return rival_distance(trial, named[0])


def _explained(explain: Explain, paths: TrialPaths) -> tuple[dict[str, Any], float]:
    begin = time.perf_counter()
    try:
        explanation = dict(explain(paths.model, paths.recordings, paths.holdout))
    except Exception as error:  # whatever it is, it belongs into the report and must not end the study
        explanation = {"verdict": "error", "error": f"{type(error).__name__}: {error}"}
    return explanation, time.perf_counter() - begin


def _result_path(folder: Path, number: int) -> Path:
    return folder / "results" / f"{number:04d}.json"


def _refusal_path(folder: Path, number: int) -> Path:
    return folder / "refused" / f"{number:04d}.json"


def _write_whole(path: Path, result: Result) -> None:
    partial = path.with_suffix(".part")
    partial.write_text(json.dumps(result, indent=1, default=str), encoding="utf-8")
    partial.replace(path)


def _same_study(requests: Sequence[Request], folder: Path) -> None:
    """Raise `BadInput` when the folder holds another study."""
    path = folder / "plan.json"
    text = json.dumps([r.as_json() for r in requests], indent=1)
    if path.exists() and path.read_text(encoding="utf-8") != text:
        raise BadInput(f"{path}: is the plan of another study; an empty folder, or the same plan, is wanted")
    path.write_text(text, encoding="utf-8")
