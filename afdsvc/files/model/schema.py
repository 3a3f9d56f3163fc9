"""The schema of MODEL.toml."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from afdsvc.files.validation import Strict

Matrix = list[list[float]]
Polynomials = list[float] | list[list[list[float]]]
Roots = list[float | Annotated[list[float], Field(min_length=2, max_length=2)]]
FORMS = (("num", "den"), ("zeros", "poles", "gain"), ("A", "B", "C", "D"))
QUANTITY = re.compile(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(.*?)\s*(?:(?:\+-|±)\s*([\d.]+)\s*%)?\s*")
COEFFICIENTS = Field(default=None, description="a list of coefficients, highest power first, such as [0.08, 1]")
ROWS = Field(default=None, description="a list of rows, such as [[0, 1], [-4, -2]]")
ROOTS = Field(default=None, description="a list of roots, such as [-12.5], or [[-1, 2], [-1, -2]] where they are complex")
Name = Annotated[str, Field(min_length=1, pattern=r"^\S(.*\S)?$")]
Positive = Annotated[float, Field(gt=0)]


class VariableTable(Strict):
    """An input or output."""

    EXPECTED: ClassVar[str] = 'a table such as {name = "voltage", unit = "V"}'
    name: Name
    unit: str = ""


class StateTable(VariableTable):
    """A state; ``rate_of`` names the state it is the time derivative of."""

    rate_of: Name | None = None


class ParameterTable(Strict):
    """A physical parameter and how well it is known; on one line: a number, or ``"95.1 kg +- 2 %"``."""

    EXPECTED: ClassVar[str] = 'a number, text such as "1.2 kg +- 5 %", or a table such as {value = 1.2, unit = "kg"}'
    value: float
    unit: str = ""
    relative_sd: Annotated[float, Field(ge=0)] = 0.05

    @model_validator(mode="before")
    @classmethod
    def _one_line(cls, value: Any) -> Any:
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            return {"value": value}
        found = QUANTITY.fullmatch(value) if isinstance(value, str) else None
        if found is None:
            return value
        number, unit, percent = found.groups()
        return {"value": float(number), "unit": unit} | ({"relative_sd": float(percent) / 100} if percent else {})


class UncertaintyTable(Strict):
    """How well entries are known: one relative figure for all that are not 0 or +-1, or absolute, matrix by matrix."""

    relative: Annotated[float, Field(ge=0)] = 0.05
    A: Matrix | None = None
    B: Matrix | None = None
    C: Matrix | None = None
    D: Matrix | None = None


class NoiseTable(Strict):
    """Standard deviation of each output's noise; covariance of the noise that drives the states."""

    output_sd: list[Positive] | None = Field(default=None, description="a list of numbers, one for each output")
    process_cov: Matrix | None = None


class LinearTable(Strict):
    """A linear system on one time base: matrices (D may be left out, and of a static gain all but D), ``num`` over ``den``
    (coefficients, highest power first; for several inputs or outputs a list for each output of a list for each input), or
    ``zeros``, ``poles`` and ``gain``, a complex root as ``[re, im]``."""

    time: Literal["continuous", "discrete"]
    sample_time: Positive | None = None
    A: Matrix | None = ROWS
    B: Matrix | None = ROWS
    C: Matrix | None = ROWS
    D: Matrix | None = ROWS
    num: Polynomials | None = COEFFICIENTS
    den: Polynomials | None = COEFFICIENTS
    zeros: Roots | None = ROOTS
    poles: Roots | None = ROOTS
    gain: float | None = None

    @field_validator("A", "B", "C", "D", mode="before")
    @classmethod
    def _rows(cls, value: Any, info: Any) -> Any:
        if isinstance(value, list) and value and not any(isinstance(row, list) for row in value):
            row = value if len(value) > 1 else [*value, 0]
            alone = "" if len(value) > 1 else f"[{value}] is one row and one column, "
            raise ValueError(f"{value} is a flat list; expected rows: {alone}[{row}] is one row, [{', '.join(f'[{v}]' for v in row)}] one column")
        return value

    @model_validator(mode="after")
    def _one_time_base(self) -> LinearTable:
        if self.time == "discrete" and self.sample_time is None:
            raise ValueError('time is "discrete" and sample_time is missing; expected seconds')
        if self.time == "continuous" and self.sample_time is not None:
            raise ValueError(f'time is "continuous" and sample_time is {self.sample_time}; expected one of the two')
        return self

    @property
    def dt(self) -> float:
        """Sample time in seconds, 0 when continuous."""
        return self.sample_time or 0.0

    @property
    def form(self) -> tuple[str, ...]:
        """The keys of the form that is given: the transfer function's, the roots', or the matrices'."""
        return next(form for form in FORMS if form[0] == "A" or any(getattr(self, key) is not None for key in form))

    def missing(self) -> list[str]:
        """Return the keys that the given form needs and lacks; ``zeros`` and ``D`` may be left out, ``B`` where there are no inputs, and all but D of a gain."""
        needless = {"zeros"} if getattr(self, "inputs", None) != [] else {"zeros", "B"}
        absent = [key for key in self.form if getattr(self, key) is None and key not in needless]
        if self.form[0] != "A":
            return absent
        return [] if absent in ([], ["D"], ["A", "B", "C"]) and (self.A or self.D is not None) else absent

    def several(self) -> list[str]:
        """Return the first keys of the forms that are given, where there is more than one."""
        given = [next(key for key in form if getattr(self, key) is not None) for form in FORMS if any(getattr(self, key) is not None for key in form)]
        return given if len(given) > 1 else []


def _form(table: LinearTable) -> None:
    """Raise `ValueError` unless one form of a linear system is given, and whole."""
    if table.several():
        raise ValueError(f"keys {' and '.join(table.several())} are both given; expected matrices, num and den, or poles and gain")
    if table.missing():
        what = "matrix" if table.form[0] == "A" else "key"
        raise ValueError(f"{what} {', '.join(table.missing())} is missing; expected A, B, C and D, or num and den, or zeros, poles and gain")


class ControllerTable(LinearTable):
    """The controller, positive feedback ``u = K (y - ref)``, linear and at rest when a recording begins. References are read from the columns
    ``ref_<output>``; one that is missing is zero. What the recorded inputs differ by from ``K (y - ref)``, such as a burst, an offset or what a
    limit has cut off, counts as added from outside and is added again, as recorded, wherever the loop is simulated. Without this table a column
    ``ref_<output>`` only says that feedback was at work."""

    @model_validator(mode="after")
    def _complete(self) -> ControllerTable:
        _form(self)
        return self


class PerturbationTable(Strict):
    """How the linear part of a simulator that only steps is looked for: pushes (in the inputs' units), samples, order."""

    amplitude: list[Positive] | None = Field(default=None, description="a list of numbers, one for each input")
    samples: Annotated[int, Field(ge=50, le=20000)] = 400
    order: Annotated[int, Field(ge=1, le=30)] | None = None


class ModelTable(LinearTable):
    """A whole MODEL.toml."""

    name: Annotated[str, Field(min_length=1)]
    inputs: list[VariableTable]
    outputs: Annotated[list[VariableTable], Field(min_length=1)]
    states: list[StateTable] = Field(default_factory=list)
    dynamics: Annotated[str, Field(pattern=r"^.+(\.py:[A-Za-z_]\w*|\.fmu)$")] | None = None
    parameters: dict[Name, ParameterTable] = Field(default_factory=dict)
    uncertainty: UncertaintyTable | None = None
    noise: NoiseTable | None = None
    controller: ControllerTable | None = None
    perturbation: PerturbationTable | None = None

    @model_validator(mode="after")
    def _matrices_or_dynamics(self) -> ModelTable:
        if self.dynamics is None:
            _form(self)
        elif any(getattr(self, key) is not None for form in FORMS for key in form):
            raise ValueError("both matrices and dynamics are given; expected one of the two")
        return self

    @model_validator(mode="after")
    def _names(self) -> ModelTable:
        for what in ("inputs", "outputs", "states"):
            names = [v.name for v in getattr(self, what)]
            twice = next((n for n in names if names.count(n) > 1), None)
            if twice:
                raise ValueError(f"{what} name '{twice}' twice; expected once")
        states = [s.name for s in self.states]
        for state in self.states:
            if state.rate_of is not None and (state.rate_of not in states or state.rate_of == state.name):
                others = ", ".join(n for n in states if n != state.name) or "none"
                found = f"rate_of of '{state.name}' is '{state.rate_of}'"
                cure = f"; where '{state.rate_of}' is not in the model, leave rate_of out: a unit such as rad/s says that it is a speed"
                raise ValueError(f"states: {found}; expected another state ({others}){cure}")
        return self


class Inline(dict[str, object]):
    """A table written on one line."""


def toml_text(table: Mapping[str, object]) -> str:
    """Return the text; numbers come back bit for bit, empty tables and lists of no entries are left out at the top."""
    plain = {k: v for k, v in table.items() if not _is_section(v)}
    sections = {k: v for k, v in table.items() if isinstance(v, dict) and _is_section(v) and v}
    text = _lines(plain)
    for name, section in sections.items():
        text += f"\n[{_key(name)}]\n{_lines(section)}"
    return text


def _lines(table: Mapping[str, object]) -> str:
    return "".join(f"{_key(name)} = {_value(value)}\n" for name, value in table.items())


def _is_section(value: object) -> bool:
    return isinstance(value, dict) and not isinstance(value, Inline)


def _value(value: object) -> str:
    if isinstance(value, str):
        # JSON strings are TOML strings but for the one control character JSON lets pass.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{_key(k)} = {_value(v)}' for k, v in value.items())}}}"
    return json.dumps(value)


def _number(value: float) -> str:
    """Return whole numbers without a point (a sign on zero would be lost that way) and others as Python writes them."""
    whole = value.is_integer() and abs(value) < 1e15 and str(value) != "-0.0"
    return str(int(value)) if whole else repr(value)


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _value(name)
