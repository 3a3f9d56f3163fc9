"""A study: its plan (how many of which question, severity and machine), and its trials through one `explain`.

It is resumable; each result is kept in a file of its own.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from afdsvc.errors import BadInput, Refused
from afdsvc.trial.answer import FieldAnswer, TrialAnswer
from afdsvc.trial.catalogue import changes_at, outside_at, physics_at
from afdsvc.trial.field.catalogue import STREAM, FieldOptions, draws
from afdsvc.trial.field.generate import FieldTrial, make
from afdsvc.trial.field_score import field_oracle, field_score
from afdsvc.trial.folder import TrialPaths, answer_of, open_seal, seal, write
from afdsvc.trial.generate import BlindTrial, TrialRequest, generate_several
from afdsvc.trial.machines import Options
from afdsvc.trial.matching import rival_distance
from afdsvc.trial.oracle import Oracle, oracle
from afdsvc.trial.score import score

FIELD = "field"  # the part whose trials `field_plan` gives
RHOS = (0.1, 0.3, 1.0)
MIX = {  # trials in 300
    "bearing": 156, "axis": 44, "nothing": 24, "change": 20, "two": 16, "outside": 14, "dirty": 10, "noise": 10, "excitation": 6,
}
ALIKE = (  # pairs from one of these sets can cancel each other in the recordings; they are not hidden together
    {"constant_load", "sensor_offset", "sensor_drift"},
    {"transport_delay", "actuator_lag", "sensor_lag", "resonant_actuator"},
    {"coulomb_friction", "stribeck_friction", "hysteresis", "backlash"},
    {"cubic_stiffness", "clearance", "saturation", "sensor_saturation"},
    {"sensor_misalignment", "sensor_crosstalk"},
)


@dataclass(frozen=True, slots=True)
class Request:
    """One trial to be made: number, part of the study, what to hide, how to stage it, seed."""

    number: int
    part: str
    wishes: tuple[TrialRequest, ...]
    options: Options | FieldOptions
    seed: tuple[int, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the request as plain values."""
        return asdict(self)


def plan(count: int, seed: int) -> list[Request]:
    """Return the requests of a study of about ``count`` trials (at least one per part), mixed as in `MIX`."""
    generator = np.random.default_rng(seed)
    requests: list[Request] = []
    for part, share in MIX.items():
        for k, (wishes, options) in zip(range(max(1, round(count * share / 300))), PARTS[part](generator), strict=False):
            number = len(requests)
            requests.append(Request(number, part, tuple(wishes), options, (seed, number, k)))
    return requests


def field_plan(count: int, seed: int) -> list[Request]:
    """Return the requests of a study of field trials, numbered from 0; another count gives the same first ones."""
    requests = []
    for k, (options, share, labels) in zip(range(count), draws(seed), strict=False):
        wishes = tuple(TrialRequest(label, None, share) for label in labels)
        requests.append(Request(k, FIELD, wishes, options, (seed, STREAM, k)))
    return requests


def make_trial(request: Request) -> BlindTrial | FieldTrial:
    """Return the trial, as asked where the machine allows it.

    What no severity can give inside the machine's reach is tried under the proportional controller, at other sites and
    shapes (three seeds), and then at 0.6 and 0.3 of the rho. Raises `Refused` when all of that fails.
    """
    if isinstance(request.options, FieldOptions):
        return make(request.options, max((w.rho for w in request.wishes), default=0.0), request.seed)
    name = "/".join(map(str, request.seed))
    for share in (1.0, 0.6, 0.3):
        wishes = [TrialRequest(w.physics, w.site, w.rho * share) for w in request.wishes]
        for attempt in range(4):
            controller = request.options.controller if attempt == 0 else "proportional"
            options = replace(request.options, controller=controller)
            try:
                return generate_several(wishes, np.random.default_rng([*request.seed, attempt]), options, f"{name}/{attempt}")
            except Refused:
                continue
    raise Refused(f"trial {name}: nothing like {request.wishes} fits the machine")


Draw = tuple[list[TrialRequest], Options]


def _bearing(generator: np.random.Generator, rho: float = 0.0) -> Options:
    """Return the bearing under either controller; the observer controller only where rho is small enough for its loop."""
    lqg = rho <= 0.3 and generator.random() < 0.4
    return Options(
        controller="lqg" if lqg else "proportional", injection="youla" if generator.random() < 0.5 else "added"
    )


def _names(options: Options) -> list[str]:
    return sorted({name for name, _ in physics_at(options.build())})


def _every(options: Options, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Yield every name at every rho, over and over, in an order that mixes both."""
    names = _names(options)
    while True:
        for turn in range(len(RHOS)):
            for i in generator.permutation(len(names)):
                yield names[i], RHOS[(int(i) + turn) % len(RHOS)]


def _on_bearing(generator: np.random.Generator) -> Iterator[Draw]:
    for name, rho in _every(Options(), generator):
        yield [TrialRequest(name, None, rho)], _bearing(generator, rho)


def _on_axis(generator: np.random.Generator) -> Iterator[Draw]:
    options = Options(machine="positioning_axis")
    for name, rho in _every(options, generator):
        yield [TrialRequest(name, None, rho)], options


def _nothing(generator: np.random.Generator) -> Iterator[Draw]:
    while True:
        for k in range(6):
            yield [], Options(machine="positioning_axis") if k == 5 else _bearing(generator)


def _change(generator: np.random.Generator) -> Iterator[Draw]:
    places = changes_at(Options().build())
    while True:
        for i in generator.permutation(len(places)):
            (name, site), rho = places[i], float(generator.choice([0.3, 0.5, 1.0]))
            yield [TrialRequest(name, site, rho)], _bearing(generator, rho)


def _two(generator: np.random.Generator) -> Iterator[Draw]:
    options = Options(controller="proportional")
    names = _names(options)
    while True:
        pair = {str(name) for name in generator.choice(names, 2, replace=False)}
        if not any(pair <= alike for alike in ALIKE):
            yield [TrialRequest(name, None, 0.6) for name in sorted(pair)], options


def _outside(generator: np.random.Generator) -> Iterator[Draw]:
    names = sorted({name for name, _ in outside_at(Options().build())})
    while True:
        for k, name in enumerate(names):
            rho = RHOS[1 + k % 2]
            yield [TrialRequest(name, None, rho)], _bearing(generator, rho)
        names = names[::-1]


def _dirty(generator: np.random.Generator) -> Iterator[Draw]:
    options = replace(_bearing(generator, 1.0), dirty=True)
    names = _names(options)
    while True:
        for k in range(5):
            yield [TrialRequest(str(generator.choice(names)), None, 0.5)] if k else [], options


def _noise(generator: np.random.Generator) -> Iterator[Draw]:
    names = _names(Options())
    while True:
        for kind in ("coloured", "process", "quieter", "louder", "process"):
            hidden = [TrialRequest(str(generator.choice(names)), None, 0.3)] if generator.random() < 0.5 else []
            yield hidden, replace(_bearing(generator, 1.0), noise=kind)


def _excitation(generator: np.random.Generator) -> Iterator[Draw]:
    names = _names(Options())
    while True:
        for kind in ("sine", "operation", "one_level"):
            yield [TrialRequest(str(generator.choice(names)), None, 0.3)], replace(_bearing(generator, 1.0), excitation=kind)


PARTS = {
    "bearing": _on_bearing, "axis": _on_axis, "nothing": _nothing, "change": _change, "two": _two, "outside": _outside,
    "dirty": _dirty, "noise": _noise, "excitation": _excitation,
}


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
