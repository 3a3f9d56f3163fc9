"""`afdsvc init`: a first MODEL.toml, a mapping file and a site file from the columns of a table or the topics of a log."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from afdsvc.api.signals import Trace
from afdsvc.dataset.units import is_velocity, unknown_unit
from afdsvc.errors import BadInput
from afdsvc.files.model.schema import Inline, toml_text
from afdsvc.files.open import Naming, OwnRecording, open_file
from afdsvc.files.tables.alignment import SHORTEST
from afdsvc.files.tables.foreign_mcap import shown
from afdsvc.files.tables.formats import opened, read_columns, stated_units
from afdsvc.files.tables.historian import is_export, read_export
from afdsvc.files.tables.mapping import REFERENCES, DataMapping, Heading, heading, role_of_unit, same_dimension, same_unit
from afdsvc.files.tables.time_base import is_stamped, own_step, own_time
from afdsvc.files.unfinished import writing
from afdsvc.identify.first_model import MOST, Polynomials, first_model

MODEL, MAPPING, SITE = "MODEL.toml", "mapping.toml", "site.toml"
ESTIMATED = "# Estimated from {file}: a lag for each speed, a resonance for any other output. Put what you know of the machine in its place.\n"
Ask = Callable[[str, str, Callable[[str], Any]], Any]  # question, default, what reads the answer
SECONDS = ("s", "ms", "us", "ns")
SMALLEST = 1e-6  # least share of the variance that is taken for noise
RELATIVE = 0.3  # how well the estimate is known where physics is missing from it
NEXT = """afdsvc check {model} {recording} --mapping {mapping}
afdsvc explain {model} {recording} --mapping {mapping}"""
OF_THE_LOG = """# Runs the model of {file} as a simulated machine; put your driver in its place. limits: what a burst may reach (the largest of the log,
# where not stated otherwise). output_sd: what the first model leaves of the log, which noise cannot exceed.
"""


@dataclass(frozen=True, slots=True)
class Answers:
    """What names of columns (or ``TOPIC.FIELD``) do not say: which are inputs and outputs, units and limits of bursts by column, and the seconds between rows.

    ``ask(question, default, parse)`` is called for what is missing and returns what ``parse`` makes of the answer; None asks nothing.
    """

    inputs: Sequence[str] = ()
    outputs: Sequence[str] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    limits: Mapping[str, str] = field(default_factory=dict)
    step: float | None = None
    ask: Ask | None = None

    @property
    def columns(self) -> list[str]:
        """Every column that is named."""
        return [*self.inputs, *self.outputs, *self.units, *self.limits]


def init_files(recording: Path, out: Path | None = None, answers: Answers | None = None, overwrite: bool = False, site: bool = False) -> dict[str, Any]:
    """Write MODEL.toml and mapping.toml for a table or a log of topics, with ``site`` also site.toml, and return what was found, column by column.

    Of topics only inputs, outputs and set points are mapped. Raises `BadInput` where there is no input or no output and no terminal to ask on, and where a file is there already.
    """
    answers = answers or Answers()
    if answers.step is not None:
        _positive("--step", str(answers.step))
    if recording.is_dir():
        opened(recording).close()
    folder = out or recording.parent
    files = [folder / name for name in (MODEL, MAPPING, *([SITE] if site else []))]
    model, mapping = files[:2]
    there = next((f for f in files if f.exists() and not overwrite), None)
    if there is not None:
        raise BadInput(f"{there}: exists already; expected another folder (--out DIR), or --overwrite")
    found, clock, left, columns = _signals(recording, answers)
    trace = _longest(open_file(recording, Naming(DataMapping.model_validate(_mapping(found, clock)))).traces())
    still = _still(recording, found, trace, answers, columns)
    found = [h for h in found if h not in still]
    ins, outs = ([h for h in found if h.role == role] for role in ("u", "y"))
    u = np.column_stack([trace.column(f"u_{h.label}") for h in ins])
    fits = [first_model(u, trace.column(f"y_{h.label}"), trace.dt, is_velocity(h.unit) if h.unit else None) for h in outs]
    machine = _site(recording, trace, ins, outs, fits, answers) if site else ""
    folder.mkdir(parents=True, exist_ok=True)
    with writing(*files):
        mapping.write_text(f"# Which column of {recording.name} is which signal, and in what unit.\n{_toml(_mapping(found, clock))}", encoding="utf-8")
        model.write_text(_model(recording, ins, outs, fits), encoding="utf-8")
        for file in files[2:]:
            file.write_text(machine, encoding="utf-8")
    return {
        "model": str(model), "mapping": str(mapping), **({"site": str(files[2])} if site else {}), "sample_time": trace.dt, "time": clock.get("from", ""),
        "columns": [{"column": h.name, "signal": f"{h.role}_{h.label}", "unit": h.unit} for h in found],
        "left_out": left | {h.name: "it never changes" for h in still},
        "fits": {h.label: {"r2": f.r2, "num": f.num, "den": f.den} for h, f in zip(outs, fits, strict=True)},
        "next": NEXT.format(model=model, recording=recording, mapping=mapping).splitlines() + [f"afdsvc site check {f}" for f in files[2:]],
    }  # fmt: skip


def _signals(recording: Path, answers: Answers) -> tuple[list[Heading], dict[str, Any], dict[str, str], list[str]]:
    """Return the signals of a recording, the ``[time]`` section of its mapping, why other columns are left out, and what could be a signal."""
    source = open_file(recording)
    if isinstance(source, OwnRecording):
        raise BadInput(f"{recording}: is a recording of afdsvc, which carries names, units and model; expected a log of other origin")
    if places := source.places():
        asked: dict[str, Sequence[str]] = {"u": answers.inputs, "y": answers.outputs}
        return [h for h in _headings(recording, places, answers, "") if h.role != "aux" and h.name in (asked.get(h.role) or places)], {}, {}, places
    columns = {n: v for n, (_, v) in read_export(recording)[0].items()} if is_export(recording) else read_columns(recording)
    _, stated = own_step(columns)
    columns = {n: v for n, v in columns.items() if len(v) > 1}  # MAT files hold numbers beside vectors
    time = own_time(columns) or next((n for n in columns if answers.units.get(n) in SECONDS or heading(n).role == "t"), "")
    if not time and answers.ask and not is_export(recording) and (answers.step or stated) is None:
        time, answers = _asked_time(list(columns), answers.ask, answers)
    stamped = {n for n, v in columns.items() if is_stamped(v)}
    signals = [n for n in columns if n != time and n not in stamped]
    found = _headings(recording, signals, answers, time)
    step = None if time or is_export(recording) else _step(recording, replace(answers, step=answers.step or stated))
    unit = "" if not time or time in stamped else answers.units.get(time) or heading(time).unit
    clock = {"from": time} | ({"unit": unit} if unit else {}) if time else {"step": step} if step else {}
    named = (time, *(h.name for h in found))
    return found, clock, {n: f"its {'cells are time stamps' if n in stamped else 'name says that it is a time'}" for n in columns if n not in named}, signals


def _still(recording: Path, found: Sequence[Heading], trace: Trace, answers: Answers, columns: Sequence[str]) -> list[Heading]:
    """Return the inputs and outputs that never change; raises `BadInput` where one of them was asked for, or no other is left."""
    still = [h for h in found if h.role in ("u", "y") and np.ptp(trace.column(f"{h.role}_{h.label}")) == 0]
    for role, word, asked in (("u", "input", answers.inputs), ("y", "output", answers.outputs)):
        names = [h.name for h in still if h.role == role]
        if set(names) & set(asked) or len(names) == sum(h.role == role for h in found):
            others = [n for n in columns if n not in {h.name for h in found}] or [h.name for h in found if h not in still]
            raise BadInput(f"{recording}: {word} {shown(names)} never changes; expected one that does: --{word} COLUMN, one of {shown(others)}")
    return still


def _longest(traces: Sequence[Trace]) -> Trace:
    """Return the longest stretch without an empty cell in an input or output; raises `BadInput` where it is too short."""
    best = traces[0].span(0, 0)
    for trace in traces:
        good = np.isfinite(np.hstack([trace.role("u"), trace.role("y")])).all(axis=1)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
        best = max([best, *(trace.span(a, b) for a, b in edges.reshape(-1, 2).tolist())], key=len)
    if len(best) < SHORTEST:
        raise BadInput(f"{best.name}: {len(best)} rows in a row have a number in every input and output; expected at least {SHORTEST}")
    return best


def _headings(recording: Path, names: Sequence[str], answers: Answers, time: str) -> list[Heading]:
    for name in answers.columns:
        if name not in (*names, time):
            raise BadInput(f"{recording}: no column '{name}'; it has {shown(names)}")
    found = [h for h in (heading(n, answers.inputs, answers.outputs) for n in names) if h.role != "t"]
    own = {n: unit for n, unit in stated_units(recording).items() if not unknown_unit(unit)}
    found = [replace(h, unit=_unit(h.name, answers.units[h.name]) if h.name in answers.units else h.unit or own.get(h.name, "")) for h in found]
    for role, word, examples in (("u", "input", "voltage_V or torque_Nm"), ("y", "output", "speed_rpm or position_mm")):
        if not any(h.role == role for h in found):  # where no name says it, units do
            found = [replace(h, role=role) if h.role == "aux" and not h.name.startswith("aux_") and role_of_unit(h.unit) == role else h for h in found]
        if any(h.role == role for h in found):
            continue
        if answers.ask is None:
            raise BadInput(f"{recording}: no column name says that it is an {word}, as {examples} does; expected --{word} COLUMN, {'one of ' + shown(names) if names else 'but it has no column beside the time'}")
        chosen = answers.ask(f"Which columns are {word}s ({', '.join(h.name for h in found if h.role == 'aux')})?", "", _chooser(found))
        found = [replace(h, role=role) if h.name in chosen else h for h in found]
    if answers.ask:
        found = [_with_unit(h, answers) for h in found]
    found = [_reference(h, [o for o in found if o.role == "y"]) for h in found]
    labels = [f"{h.role}_{h.label}" for h in found]
    return [replace(h, label=f"{h.label}_{k}") if labels.count(f"{h.role}_{h.label}") > 1 else h for k, h in enumerate(found, 1)]


def _reference(h: Heading, outputs: Sequence[Heading]) -> Heading:
    """Return a set point under the name of the output it is for: that of its name without "reference", or the only one of its unit."""
    if h.role != "ref" or h.name.startswith("ref_"):
        return h
    rest = "_".join(word for word in h.label.split("_") if word not in REFERENCES)
    fits = [o for o in outputs if same_dimension(h.unit or o.unit, o.unit)]
    of = [o for o in fits if o.label == rest] or (fits if len(fits) == 1 else [])
    return replace(h, label=of[0].label) if of else h


def _chooser(found: Sequence[Heading]) -> Callable[[str], list[str]]:
    """Return what reads columns without a role from an answer, commas between them; it raises `BadInput` for any other."""
    free = [h.name for h in found if h.role == "aux"]

    def chosen(answer: str) -> list[str]:
        columns = [c.strip() for c in answer.split(",")]
        for column in columns:
            if column not in free:
                raise BadInput(f"no column '{column}' without a role; expected one or more of {', '.join(free)}, with commas between them")
        return columns

    return chosen


def _with_unit(h: Heading, answers: Answers) -> Heading:
    """Return an input or output with its unit, asked for where it is not stated: that of a speed decides what the first model is."""
    if answers.ask is None or h.role == "aux" or h.unit or h.name in answers.units:
        return h
    return replace(h, unit=answers.ask(f"Unit of {h.name}, such as rpm, mm or V (Enter where it has none)", "", lambda text: _unit(h.name, text.strip())))


def _unit(column: str, text: str) -> str:
    """Return a unit that is known; raises `BadInput` for any other."""
    if text:
        same_unit(text, f"{text}*1", f"column '{column}'")
    return text


def _mapping(found: Sequence[Heading], clock: dict[str, Any]) -> dict[str, Any]:
    signals = {f"{h.role}_{h.label}": {"from": h.name} | ({"unit": h.unit} if h.unit else {}) for h in found}
    return ({"time": clock} if clock else {}) | {"signals": signals}


def _asked_time(columns: Sequence[str], ask: Ask, answers: Answers) -> tuple[str, Answers]:
    """Return the column that is named as the time, "" for none, and the answers with its unit."""

    def one_of(names: Sequence[str]) -> Callable[[str], str]:
        def chosen(text: str) -> str:
            if text.strip() not in ("", *names):
                raise BadInput(f"found '{text.strip()}'; expected one of {', '.join(names)}")
            return text.strip()

        return chosen

    time = ask(f"No name says which column is the time. Which one is ({', '.join(columns)}; Enter: none)?", "", one_of(columns))
    unit = {time: ask(f"Unit of {time} (s, ms, us or ns)", "s", one_of(SECONDS))} if time else {}
    return time, replace(answers, units={**answers.units, **unit})


def _step(recording: Path, answers: Answers) -> float:
    """Return the seconds between rows of a table whose columns hold no time; raises `BadInput` where they are not stated."""
    if answers.step is not None:
        return _positive("--step", str(answers.step))
    if answers.ask is None:
        raise BadInput(f"{recording}: no column is the time; expected one named t, t_ms or timestamp, --unit COLUMN=s (or ms, us, ns), or --step SECONDS, the time between rows")
    return float(answers.ask("No column is the time. Seconds between rows", "", lambda text: _positive("seconds between rows", text)))


def _toml(text: dict[str, Any]) -> str:
    return toml_text({k: {n: Inline(v) if isinstance(v, dict) else v for n, v in section.items()} for k, section in text.items()}).lstrip()


def _model(recording: Path, ins: Sequence[Heading], outs: Sequence[Heading], fits: Sequence[Polynomials]) -> str:
    single = len(ins) == len(outs) == 1
    table = {
        "name": recording.stem, "time": "continuous",
        "inputs": [Inline(name=h.label, unit=h.unit) for h in ins], "outputs": [Inline(name=h.label, unit=h.unit) for h in outs],
        "num": list(fits[0].num) if single else [[[v] for v in f.num] for f in fits],
        "den": list(fits[0].den) if single else [[list(f.den)] * len(ins) for f in fits],
        "uncertainty": {"relative": RELATIVE},
    }  # fmt: skip
    return ESTIMATED.format(file=recording.name) + toml_text(table)


def _site(recording: Path, trace: Trace, ins: Sequence[Heading], outs: Sequence[Heading], fits: Sequence[Polynomials], answers: Answers) -> str:
    id = re.sub(r"[^A-Za-z0-9_.-]+", "-", recording.stem).strip("-_.") or "machine"
    left = [float(trace.column(f"y_{h.label}")[:MOST].std()) * max(1 - f.r2, SMALLEST) ** 0.5 for h, f in zip(outs, fits, strict=True)]
    limits = {word: [_limit(h, trace, answers) for h in of] for word, of in (("input", ins), ("output", outs))}
    machine = {
        "id": id, "model": MODEL, "options": Inline(sample_time=trace.dt), "driver": Inline(kind="simulator"), "limits": Inline(limits),
        "output_sd": [float(f"{sd:.3g}") for sd in left],
    }  # fmt: skip
    return OF_THE_LOG.format(file=recording.name) + toml_text({"site": id}) + "\n[[machines]]\n" + toml_text(machine)


def _limit(h: Heading, trace: Trace, answers: Answers) -> float:
    """Return the largest magnitude that a burst may reach: stated, asked for, or that of the log."""
    seen = f"{np.abs(trace.column(f'{h.role}_{h.label}')).max():.3g}"
    if h.name in answers.limits or answers.ask is None:
        return _positive(f"limit of '{h.name}'", answers.limits.get(h.name, seen))
    return float(answers.ask(f"Largest magnitude of {h.name} during a burst{f' [{h.unit}]' if h.unit else ''}", seen, lambda text: _positive(f"limit of '{h.name}'", text)))


def _positive(what: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0 < value < float("inf"):
        raise BadInput(f"{what}: found '{text}'; expected a number above 0")
    return value
