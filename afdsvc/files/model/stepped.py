"""A MODEL.toml whose simulator only steps (an FMI unit, a Python function): its linear part, and how that was found."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import numpy as np

from afdsvc.api.model import Dynamics, SteppedPlant
from afdsvc.errors import BadInput
from afdsvc.files.allowed_code import allowed, sha256_of
from afdsvc.files.model.schema import Inline, ModelTable, PerturbationTable, toml_text
from afdsvc.lti.sampling import continuous, sample_zoh
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.plants.stepped.fmi_unit import FmiUnit, describe
from afdsvc.plants.stepped.function_plant import FunctionPlant
from afdsvc.plants.stepped.linearise import STILL, LinearPart, linear_part

# Keys of Model.extra: sentences on the linear part, and the outputs where the simulator rests.
LINEARISED, REST = "linearised", "rest"


@dataclass(frozen=True, slots=True, eq=False)
class SteppedModel:
    """The linear part (continuous where there is a continuous one), how to open the simulator, and what to report."""

    plant: StateSpace
    opened: Callable[[], SteppedPlant]
    extra: Mapping[str, Any]


def unit_text(path: Path) -> str:
    """Return the MODEL.toml text an FMI unit stands for; raises `BadInput` when it does not say enough."""
    unit = describe(path)
    if unit.step is None:
        expected = f'expected a MODEL.toml with dynamics = "{path.name}" and sample_time'
        raise BadInput(f"{path}: states no step size in its default experiment; {expected}")
    sides = {"inputs": unit.inputs, "outputs": unit.outputs}
    for side, names in sides.items():
        if not names:
            raise BadInput(f"{path}: has no real {side}; expected at least one")
    variables = {side: [Inline(name=n, unit=u) for n, u in names.items()] for side, names in sides.items()}
    return toml_text({"name": unit.name, "time": "discrete", "sample_time": unit.step, **variables, "dynamics": path.name})


def stepped_model(table: ModelTable, source: str, allow_code: bool) -> SteppedModel | None:
    """Return what stands behind a model whose simulator only steps; None for any other model."""
    opened = _opener(table, source, allow_code)
    if opened is None:
        if table.perturbation is not None:
            raise BadInput(f"{source}: key 'perturbation' applies to stepped simulators only (an FMI unit or a function)")
        return None
    if not table.dt:
        raise BadInput(f'{source}: key \'time\' is "{table.time}"; a stepped simulator needs "discrete" and its sample_time')
    asked = table.perturbation or PerturbationTable()
    push = np.array(asked.amplitude or [1.0] * len(table.inputs))
    if len(push) != len(table.inputs):
        raise BadInput(f"{source}: key 'perturbation.amplitude' holds {len(push)} values; expected {len(table.inputs)}, one per input")
    unit = opened()
    try:
        part = linear_part(unit, push, table.dt, asked.samples, np.random.default_rng(0), asked.order, table.dynamics or source)
    finally:
        unit.close()
    plant = _continuous(part.plant, bool(table.states))
    extra = {LINEARISED: _sentences(table, part, plant, push, asked.samples), REST: part.rest.tolist()}
    return SteppedModel(plant, opened, extra)


def _opener(table: ModelTable, source: str, allow_code: bool) -> Callable[[], SteppedPlant] | None:
    reference = table.dynamics
    if reference is None:
        return None
    refuse_code(reference, source, allow_code)
    options = {name: quantity.value for name, quantity in table.parameters.items()}
    inputs, outputs, states = ([v.name for v in side] for side in (table.inputs, table.outputs, table.states))
    if reference.endswith(".fmu"):
        return partial(FmiUnit, Path(source).parent / reference, inputs, outputs, options, states)
    found = load_code(reference, Path(source).parent, f"{source}: key 'dynamics'")
    if not callable(found) or hasattr(found, "f") or hasattr(found, "h"):
        return None
    return partial(FunctionPlant, found, reference, len(inputs), len(outputs), options)


def _continuous(plant: StateSpace, named: bool) -> StateSpace:
    """Return the continuous plant with this sampling, in its own states or else in modes; the plant itself where there is none."""
    found = continuous(plant)
    if found is None:
        return plant
    clean = _cleaned(found if named else _modal(found))
    again = sample_zoh(clean, plant.dt)
    u = np.zeros((200, plant.inputs))
    u[0] = 1.0
    one, other = (_response(s, u) for s in (plant, again))
    return clean if np.abs(one - other).max() <= 1e-6 * np.abs(one).max() else plant


def _response(plant: StateSpace, u: Array) -> Array:
    x, y = np.zeros(plant.order), []
    for held in u:
        y.append(plant.C @ x)
        x = plant.A @ x + plant.B @ held
    return np.array(y)


def _cleaned(plant: StateSpace) -> StateSpace:
    """Return the plant with entries that are 0 or 1 but for rounding as such: those are structure, not uncertain numbers."""

    def clean(matrix: Array) -> Array:
        small = np.abs(matrix) < 1e-9 * max(float(np.abs(matrix).max(initial=0.0)), 1e-300)
        return np.where(small, 0.0, np.where(np.abs(matrix - 1) < 1e-9, 1.0, matrix))

    return StateSpace(clean(plant.A), clean(plant.B), clean(plant.C), plant.D, plant.dt)


def _modal(plant: StateSpace) -> StateSpace:
    """Return the plant in its modes, whose few entries mean damping and frequency; as it is where modes coincide."""
    poles, vectors = np.linalg.eig(plant.A)
    columns = []
    for pole, v in zip(poles, vectors.T, strict=True):
        if pole.imag > 1e-12 * abs(pole):
            columns += [v.real, v.imag]
        elif abs(pole.imag) <= 1e-12 * abs(pole):
            columns.append(v.real)
    T = np.array(columns).T
    if T.shape != plant.A.shape or np.linalg.cond(T) > 1e6:
        return plant
    return StateSpace(np.linalg.solve(T, plant.A @ T), np.linalg.solve(T, plant.B), plant.C @ T, plant.D, plant.dt)


def _sentences(table: ModelTable, part: LinearPart, plant: StateSpace, push: Array, samples: int) -> tuple[str, ...]:
    pushes = ", ".join(f"{v.name} by {a:g}{' ' + v.unit if v.unit else ''}" for v, a in zip(table.inputs, push, strict=True))
    looked = f"its states {', '.join(s.name for s in table.states)}" if table.states else "its outputs"
    kind = "continuous" if not plant.discrete else "sampled"
    said = [
        f"{table.dynamics} only steps, so what is worked with is its linear part of order {plant.order} ({kind}) around its start: the inputs "
        f"were pushed ({pushes}) and {looked} looked at for {samples} steps of {table.dt:g} s",
        f"that linear part misses {100 * round(part.missed, 9):.2g} % of the simulator's answer to a random push of the same size, "
        f"and twice the push changes the answer by {100 * round(part.bent, 9):.2g} % of itself"
        + ("" if max(part.missed, part.bent) < 0.05 else ": the simulator is not linear, and what it does beyond is not in the nominal model"),
    ]
    if part.drift > STILL:
        said.append(f"left alone from its start, the simulator's outputs move by {100 * part.drift:.2g} % of its answer to a pulse")
    return tuple(said)


TRUSTED = "AFDSVC_TRUSTED"


def load_dynamics(reference: str, source: str, allow_code: bool) -> Dynamics:
    """Return the object ``file.py:name``, relative to the model; raises `BadInput` naming what is not there."""
    refuse_code(reference, source, allow_code)
    file, name = reference.rsplit(":", 1)
    found = load_code(reference, Path(source).parent, f"{source}: key 'dynamics'")
    missing = [method for method in "fh" if not callable(getattr(found, method, None))]
    if missing:
        expected = "expected f(t, x, u, p) and h(t, x, u, p)"
        raise BadInput(f"{source}: key 'dynamics' names {Path(source).parent / file}, where '{name}' has no {' and no '.join(missing)}; {expected}")
    return cast(Dynamics, found)


def refuse_code(reference: str, source: str, allow_code: bool, key: str = "") -> None:
    """Raise `BadInput` when code would run without permission: the one gate in front of all code that a file names.

    ``source`` is the file that must lie in a trusted folder, ``key`` (the file's key ``dynamics`` by default) is for the sentence.
    """
    if allow_code or _trusted(Path(source)):
        return
    code = Path(source).parent / (reference if reference.endswith(".fmu") else reference.rpartition(":")[0])
    if Path(source).is_file() and allowed(code):  # a model inside a recording is not a file of its own and never permitted by that
        return
    kind = "compiled code" if reference.endswith(".fmu") else "Python code"
    where = key or f"{source}: key 'dynamics'"
    seal, remembered = (f" (SHA-256 {sha256_of(code)})", f", 'afdsvc allow-code {code}'") if code.is_file() else ("", "")
    others = f"{remembered}, or a folder named in {TRUSTED}"
    if not key and not Path(source).is_file():
        others = "; 'diagnose' never runs the code of a model inside a recording: give it the model as a file (--model)"
    raise BadInput(f"{where} is '{reference}', {kind}{seal} that would run on this computer; expected permission to run code: --allow-code (allow_code=True){others}")


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

    A model inside a recording is not a file of its own and never trusted.
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
    if spec is None:
        raise BadInput(f"{where}, which is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[label] = module  # dataclasses and pickles look their module up here
    try:
        exec(compile(path.read_bytes(), str(path), "exec", dont_inherit=True), module.__dict__)  # the file that is permitted, not compiled code beside it
    except Exception as error:
        del sys.modules[label]
        raise BadInput(f"{where}, which fails with {type(error).__name__}: {error}") from error
    return module
