"""MODEL.toml read and written: variables, matrices with their shapes checked, and the uncertainty of their entries.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from afdsvc.api.model import DEFAULT_RELATIVE_SD, Dynamics, Model, Quantity, Variable, default_states
from afdsvc.errors import BadInput
from afdsvc.files.model.schema import Inline, LinearTable, Matrix, ModelTable, UncertaintyTable, toml_text
from afdsvc.files.model.stepped import load_dynamics, offered_linear_part, stepped_model, unit_text
from afdsvc.files.unfinished import writing
from afdsvc.files.validation import read_text, toml_table, validated
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.transfer_function import from_polynomials, from_roots

# Keys of Model.extra, so that a file is written back in the form in which it was read.
RELATIVE, DYNAMICS = "uncertainty.relative", "dynamics"


def read_model(path: str | Path, allow_code: bool = False) -> Model:
    """Return the model in a file; raises `BadInput` naming file, key, value found and value expected.

    A model whose dynamics are Python code is refused unless ``allow_code`` is True or the file lies in a trusted folder; its
    ``plant`` is the linear part the code offers (None when it offers none). An FMI unit (``.fmu``) may stand for a whole file:
    names, units and step are then its own.
    """
    if Path(path).suffix.lower() in (".csv", ".parquet", ".mat", ".npz", ".mcap"):
        raise BadInput(f"{path}: is a recording; expected the model (MODEL.toml) here, recordings after it")
    text = unit_text(Path(path)) if str(path).lower().endswith(".fmu") else read_text(Path(path))
    return parse_model(text, str(path), allow_code)


def parse_model(text: str, source: str, allow_code: bool = False) -> Model:
    """Return the model in a text that came from ``source`` (a path, or a place inside a recording)."""
    data = toml_table(text, source)
    if "machines" in data:
        raise BadInput(f"{source}: is a site file; expected a model (MODEL.toml), with inputs and outputs")
    table = validated(ModelTable, data, source)
    stepped = stepped_model(table, source, allow_code)
    dynamics = load_dynamics(table.dynamics, source, allow_code) if table.dynamics and not stepped else None
    plant = stepped.plant if stepped else _plant(table, dynamics, source)
    return Model(
        name=table.name,
        inputs=tuple(Variable(v.name, v.unit) for v in table.inputs),
        outputs=tuple(Variable(v.name, v.unit) for v in table.outputs),
        states=_states(table, None if dynamics else plant, source),
        plant=plant,
        dynamics=dynamics,
        sample_time=table.dt,
        parameters={k: Quantity(q.value, q.unit, q.relative_sd) for k, q in table.parameters.items()},
        entry_sd=_entry_sd(table, None if dynamics else plant, source),
        output_sd=_output_sd(table, source),
        process_cov=_covariance(table.noise.process_cov if table.noise else None, _order(table, None if dynamics else plant), source),
        controller=_controller(table, source),
        origin=source,
        raw="" if stepped else text,
        extra={**_form(table), **(stepped.extra if stepped else {})},
        opened=stepped.opened if stepped else None,
        transfer=not (dynamics or stepped) and table.form[0] != "A",
        sd_stated=table.uncertainty is not None,
    )


def write_model(model: Model, path: str | Path) -> None:
    """Write the model; what `read_model` makes of the file equals it. Replaces the file only when it is complete."""
    path = Path(path)
    text = model_text(model, path.parent)
    partial = path.with_name(path.name + ".part")
    try:
        with writing(partial):
            partial.write_text(text, encoding="utf-8")
            os.replace(partial, path)
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror or error}") from None


def model_text(model: Model, folder: Path | None = None) -> str:
    """Return the model as MODEL.toml text to be kept in ``folder``, which a path to Python code is made relative to."""
    return toml_text(
        {
            "name": model.name,
            **_time_keys(model.plant.dt if model.plant and model.dynamics is None else model.sample_time),
            "inputs": [Inline(name=v.name, unit=v.unit) for v in model.inputs],
            "outputs": [Inline(name=v.name, unit=v.unit) for v in model.outputs],
            "states": [_state_entry(v) for v in model.states],
            **_dynamics_keys(model, folder),
            "parameters": {name: _parameter_entry(q) for name, q in model.parameters.items()},
            "uncertainty": _uncertainty_keys(model),
            "noise": _noise_keys(model),
            "controller": _time_keys(model.controller.dt) | _matrix_keys(model.controller) if model.controller else {},
        }
    )


def _plant(table: ModelTable, dynamics: Dynamics | None, source: str) -> StateSpace | None:
    if dynamics is not None:
        return offered_linear_part(dynamics)
    return _linear_system(table, len(table.inputs), len(table.outputs), source)


def _states(table: ModelTable, plant: StateSpace | None, source: str) -> tuple[Variable, ...]:
    if plant is not None and not table.states:
        return default_states(plant, [Variable(v.name, v.unit) for v in table.outputs])
    if plant is not None and len(table.states) != plant.order:
        found, expected = len(table.states), plant.order
        raise BadInput(f"{source}: key 'states' names {found} states; expected {expected}, as many as A has")
    return tuple(Variable(s.name, s.unit, s.rate_of) for s in table.states)


def _order(table: ModelTable, plant: StateSpace | None) -> int:
    return len(table.states) if plant is None else plant.order


def _entry_sd(table: ModelTable, plant: StateSpace | None, source: str) -> dict[str, Array]:
    if plant is not None:
        return _entry_deviations(plant, table.uncertainty, source)
    if table.uncertainty is not None:
        expected = "expected relative_sd of each parameter where the model states dynamics"
        raise BadInput(f"{source}: key 'uncertainty' is about matrices; {expected}")
    return {}


def _output_sd(table: ModelTable, source: str) -> Array | None:
    if table.noise is None or table.noise.output_sd is None:
        return None
    found, expected = len(table.noise.output_sd), len(table.outputs)
    if found != expected:
        raise BadInput(f"{source}: key 'noise.output_sd' holds {found} values; expected {expected}, one per output")
    return np.array(table.noise.output_sd)


def _controller(table: ModelTable, source: str) -> StateSpace | None:
    if table.controller is None:
        return None
    return _linear_system(table.controller, len(table.outputs), len(table.inputs), source, "controller.")


def _form(table: ModelTable) -> dict[str, object]:
    form: dict[str, object] = {DYNAMICS: table.dynamics} if table.dynamics else {}
    if table.uncertainty is not None and "relative" in table.uncertainty.model_fields_set:
        form[RELATIVE] = table.uncertainty.relative
    return form


def _time_keys(dt: float) -> dict[str, object]:
    return {"time": "discrete", "sample_time": dt} if dt else {"time": "continuous"}


def _matrix_keys(system: StateSpace) -> dict[str, object]:
    return {name: getattr(system, name).tolist() for name in "ABCD"}


def _state_entry(state: Variable) -> Inline:
    rate = {} if state.rate_of is None else {"rate_of": state.rate_of}
    return Inline(name=state.name, unit=state.unit, **rate)


def _parameter_entry(quantity: Quantity) -> Inline:
    return Inline(value=quantity.value, unit=quantity.unit, relative_sd=quantity.relative_sd)


def _dynamics_keys(model: Model, folder: Path | None) -> dict[str, object]:
    if model.plant is not None and model.dynamics is None:
        return _matrix_keys(model.plant)
    if DYNAMICS not in model.extra:
        raise BadInput(f"model '{model.name}' has neither matrices nor a file its dynamics come from")
    return {"dynamics": relative_code(str(model.extra[DYNAMICS]), model.origin, folder)}


def relative_code(reference: str, origin: str, folder: Path | None) -> str:
    """Return the reference ``file.py:name`` of a model read from ``origin`` as seen from ``folder``; modules keep their names."""
    file, name = reference.rsplit(":", 1)
    if folder is None or not origin or not file.endswith(".py"):
        return reference
    return f"{os.path.relpath((Path(origin).parent / file).resolve(), folder.resolve())}:{name}"


def _uncertainty_keys(model: Model) -> dict[str, object]:
    """Return the relative figure where it gives the deviations exactly, and absolute matrices where it does not."""
    if model.plant is None or not model.entry_sd:
        return {}
    relative = float(model.extra.get(RELATIVE, DEFAULT_RELATIVE_SD))
    keys: dict[str, object] = {"relative": relative} if RELATIVE in model.extra else {}
    for name, deviation in model.entry_sd.items():
        if not np.array_equal(deviation, _relative_deviation(getattr(model.plant, name), relative)):
            keys[name] = deviation.tolist()
    return keys or ({"relative": relative} if model.sd_stated else {})


def _noise_keys(model: Model) -> dict[str, object]:
    values = {"output_sd": model.output_sd, "process_cov": model.process_cov}
    return {key: value.tolist() for key, value in values.items() if value is not None}


def _linear_system(table: LinearTable, inputs: int, outputs: int, source: str, prefix: str = "") -> StateSpace:
    """Return the system of a table; raises `BadInput` naming file, key, shape found and shape expected."""
    if table.form[0] != "A":
        return _transfer_function(table, inputs, outputs, source, prefix)
    order = len(table.A or [])
    shapes = {"A": (order, order), "B": (order, inputs), "C": (outputs, order), "D": (outputs, inputs)}
    matrices = {}
    for name, shape in shapes.items():
        why = f"{order} states, {inputs} inputs and {outputs} outputs"
        given = getattr(table, name)
        matrices[name] = np.zeros(shape) if given is None else _checked_matrix(given, shape, f"{source}: key '{prefix}{name}'", why)
    return StateSpace(**matrices, dt=table.dt)


def _transfer_function(table: LinearTable, inputs: int, outputs: int, source: str, prefix: str) -> StateSpace:
    """Return the system of polynomials or roots."""
    try:
        if table.poles is not None:
            if (inputs, outputs) != (1, 1):
                raise BadInput(f"zeros, poles and gain are for one input and one output, not {inputs} and {outputs}; expected num and den")
            zeros, poles = ([complex(*r) if isinstance(r, list) else complex(r) for r in roots or []] for roots in (table.zeros, table.poles))
            return from_roots(zeros, poles, table.gain or 0.0, table.dt)
        num, den = (_polynomials(getattr(table, key), inputs, outputs, key) for key in ("num", "den"))
        led = next((d for row in den for d in row if len(d) > 1 and d[0] == 0), None)
        if led is not None:
            raise BadInput(f"key 'den' begins with 0 in {[float(v) for v in led]}; expected the coefficient of the highest power first, and a point as decimal sign")
        return from_polynomials(num, den, table.dt)
    except BadInput as error:
        raise BadInput(f"{source}: {f'table {prefix[:-1]}: ' if prefix else ''}{error}") from None


def _polynomials(given: Any, inputs: int, outputs: int, key: str) -> list[list[list[float]]]:
    """Return polynomials by output and input; a plain list is that of one input and output, or the denominator of all."""
    flat = not any(isinstance(part, list) for part in given)
    if flat and (key == "den" or inputs == outputs == 1):
        return [[given] * inputs] * outputs
    if flat or len(given) != outputs or any(len(row) != inputs for row in given):
        raise BadInput(f"key '{key}' is not a list of {outputs} outputs of {inputs} inputs; expected {key} = [[[1, 2], ...], ...], output by output")
    return list(given)


def _checked_matrix(rows: Matrix, shape: tuple[int, int], where: str, why: str) -> Array:
    """Return rows as an array; raises `BadInput` for ragged rows or another shape (``[]`` is any empty matrix)."""
    widths = sorted({len(row) for row in rows})
    if len(widths) > 1:
        raise BadInput(f"{where} has rows of {widths} entries; expected rows of equal length")
    found = (len(rows), widths[0] if widths else 0)
    if 0 in shape and 0 in found:
        return np.zeros(shape)
    if found != shape:
        raise BadInput(f"{where} has shape {found}; expected {shape} for {why}")
    return np.array(rows, dtype=np.float64)


def _entry_deviations(plant: StateSpace, table: UncertaintyTable | None, source: str) -> dict[str, Array]:
    """Return absolute standard deviations of the entries of A, B, C and D, shapes as theirs."""
    relative = DEFAULT_RELATIVE_SD if table is None else table.relative
    deviations = {name: _relative_deviation(getattr(plant, name), relative) for name in "ABCD"}
    for name in "ABCD":
        rows = None if table is None else getattr(table, name)
        if rows is not None:
            where = f"{source}: key 'uncertainty.{name}'"
            given = _checked_matrix(rows, deviations[name].shape, where, f"the entries of {name}")
            if (given < 0).any():
                raise BadInput(f"{where} holds {given.min()}; expected standard deviations of 0 or more")
            deviations[name] = given
    return deviations


def _relative_deviation(matrix: Array, relative: float) -> Array:
    """Return the deviation of every entry that is not 0 or +-1 (those are structure, not measured) as a share of it."""
    return np.where(np.isin(matrix, (0.0, 1.0, -1.0)), 0.0, relative * np.abs(matrix))


def _covariance(rows: Matrix | None, order: int, source: str) -> Array | None:
    """Return the covariance of the state noise; raises `BadInput` unless it is symmetric and not negative."""
    if rows is None:
        return None
    where = f"{source}: key 'noise.process_cov'"
    cov = _checked_matrix(rows, (order, order), where, f"{order} states")
    if not np.array_equal(cov, cov.T):
        raise BadInput(f"{where} is not symmetric; expected a covariance")
    if order and np.linalg.eigvalsh(cov)[0] < -1e-12 * max(np.abs(cov).max(), 1e-300):
        raise BadInput(f"{where} has the eigenvalue {np.linalg.eigvalsh(cov)[0]:.3g}; expected none below 0")
    return cov
