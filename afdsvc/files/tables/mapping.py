"""Which column or topic of a foreign recording is which signal, in what unit, on what time: by a mapping file, or by what names of columns say."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_validator, model_validator

from afdsvc.api.signals import ROLES, Channel
from afdsvc.dataset.units import parsed_unit, unit_registry, unknown_unit
from afdsvc.errors import BadInput
from afdsvc.files.validation import Strict, read_text, toml_table, validated
from afdsvc.lti.statespace import Array

Positive = Annotated[float, Field(gt=0)]
OWN_TIMES = ("header", "log", "publish", "auto")


class Source(Strict):
    """Where a signal comes from: ``value [to] = (stored [unit] + offset [unit]) * factor [factor_unit]``."""

    place: str = Field(alias="from", min_length=1)
    unit: str = ""
    offset: float = 0.0
    factor: float = 1.0
    factor_unit: str = ""
    to: str = ""

    @field_validator("factor")
    @classmethod
    def _not_zero(cls, value: float) -> float:
        if value == 0:
            raise ValueError("0 would leave nothing of the signal; expected another factor")
        return value

    @model_validator(mode="after")
    def _whole(self) -> Source:
        if self.factor_unit and not self.unit:
            raise ValueError("'factor_unit' needs 'unit', what is stored")
        return self


class Time(Strict):
    """The time of a sample.

    ``from`` is "header" (the stamp inside each message), "log", "publish", "auto" (header where every message has one, else
    log), or a field or column with its ``unit``. ``regular``: the stamps jitter, the sampling did not. ``step`` [s] is for a
    table without any time.
    """

    place: str = Field(alias="from", default="auto", min_length=1)
    unit: str = "s"
    regular: bool = False
    step: Positive | None = None


class Resample(Strict):
    """The sample time [s] (default: the model's, or that of the slowest signal that is not ``aux_``), and what counts as a gap, in samples.

    ``hold``: a value is stored when it changes, and holds until the next one, as historians do; ``dt`` has to be given then.
    """

    dt: Positive | None = None
    gap: Annotated[float, Field(gt=1.05)] = 1.5
    hold: bool = False

    @model_validator(mode="after")
    def _on_a_grid(self) -> Resample:
        if self.hold and self.dt is None:
            raise ValueError("'hold' needs 'dt', the sample time in seconds")
        return self


class DataMapping(Strict):
    """A whole mapping file; ``signals`` maps names with a role (``u_force``) to where they come from."""

    signals: dict[str, Source] = Field(default_factory=dict)
    time: Time = Time()
    resample: Resample = Resample()

    @field_validator("signals", mode="before")
    @classmethod
    def _short(cls, value: object) -> object:
        """A signal that is only a place may be written as text."""
        if not isinstance(value, dict):
            return value
        return {name: {"from": source} if isinstance(source, str) else source for name, source in value.items()}

    @field_validator("signals")
    @classmethod
    def _roles(cls, value: dict[str, Source]) -> dict[str, Source]:
        for name in value:
            try:
                Channel(name)
            except BadInput as error:
                raise ValueError(str(error).replace("column", "signal")) from None
        return value

    def extended(self, pairs: Mapping[str, str]) -> DataMapping:
        """Return the mapping with further signals, given as place to name."""
        more = {name: Source.model_validate({"from": place}) for place, name in pairs.items() if name}
        return self.model_copy(update={"signals": {**self.signals, **more}})


def read_mapping(path: str | Path) -> DataMapping:
    """Return the mapping in a TOML file; raises `BadInput` naming file, key, value found and value expected."""
    found = validated(DataMapping, toml_table(read_text(Path(path)), str(path)), str(path))
    if not found.signals:
        raise BadInput(f"{path}: key 'signals' maps nothing; expected at least one signal such as u_force")
    return found


def converted(values: Array, source: str, target: str, where: str) -> Array:
    """Return the values in the unit ``target``; the same array where the two are one unit.

    Raises `BadInput`, beginning with ``where``, for an unknown unit, for two units of different dimension, and for Hz on
    one side and an angle on the other: a frequency is not an angular speed, and which of the two was meant is not in the numbers.
    """
    if same_unit(source, target, where):
        return values
    _refuse_unlike(source, target, where)
    try:
        return np.asarray(unit_registry().Quantity(values, source).to(target).magnitude, dtype=np.float64)
    except Exception as error:
        raise BadInput(f"{where}: '{source}' cannot become '{target}': {error}") from None


def same_unit(one: str, other: str, where: str) -> bool:
    """Whether two units are the same one, however spelt; raises `BadInput` for an unknown one."""
    return one == other or bool(_unit(one, where) == _unit(other, where))


def product(one: str, other: str, where: str) -> str:
    """Return the unit of a product, such as N from A and N/A."""
    return f"{(_unit(one, where) * _unit(other, where)):~}"


def _refuse_unlike(source: str, target: str, where: str) -> None:
    units = [_unit(text, where) for text in (source, target)]
    if units[0].dimensionality != units[1].dimensionality:
        raise BadInput(f"{where}: '{source}' cannot become '{target}': their dimensions differ")
    frequency = ["hertz" in str(u) for u in units]
    if frequency[0] != frequency[1]:
        raise BadInput(
            f"{where}: '{source}' and '{target}' differ by 2 pi or not, depending on who wrote it; "
            "expected 'cycle/s' for turns per second or 'rad/s' instead of Hz"
        )


def _unit(text: str, where: str) -> Any:
    if wrong := unknown_unit(text):
        raise BadInput(f"{where}: {wrong}")
    return parsed_unit(text)


INPUTS = ("voltage", "force", "torque", "current", "command", "duty", "pwm", "drive", "valve", "input", "effort")
OUTPUTS = ("position", "speed", "velocity", "angle", "acceleration", "displacement", "pressure", "level", "rate", "output", "rpm", "deflection")
REFERENCES = ("reference", "ref", "setpoint", "target", "desired")
TIMES = ("t", "time", "timestamp", "datetime", "date", "zeit", "stamp")
UNITS = {"u": ("V", "A", "N", "N*m"), "y": ("rpm", "m", "m/s", "m/s^2")}  # what machines are driven by, and how they move
NO_UNITS = ("PV", "MV", "CV", "SP", "OP", "U", "act", "point")  # last words of names that would else be petavolts, megavolts and the like
SPELT = {"Nm": "N*m", "U/min": "rpm", "r/min": "rpm", "C": "degC", "degs": "deg/s", "rads": "rad/s", "mps": "m/s", "mms": "mm/s", "mpa": "MPa"}
QUANTITIES = {"voltage": "V", "current": "A", "force": "N", "torque": "N*m", "pressure": "Pa", "temp": "degC", "power": "W", "freq": "Hz"}


@dataclass(frozen=True, slots=True)
class Heading:
    """A column: its ``name`` in the file, the ``label`` and ``unit`` it says, and its role ("u", "y", "aux", or "t" for the time)."""

    name: str
    label: str
    unit: str
    role: str


def heading(name: str, inputs: Sequence[str] = (), outputs: Sequence[str] = ()) -> Heading:
    """Return what a name says; ``inputs`` and ``outputs`` hold names whose role is known.

    >>> heading("speed_rpm")
    Heading(name='speed_rpm', label='speed', unit='rpm', role='y')
    >>> heading("Motor Torque [Nm]").role, heading("t_ms").unit, heading("aux_temperature").role
    ('u', 'ms', 'aux')
    """
    prefix, _, rest = name.partition("_")
    own = prefix if prefix in ROLES and rest else ""
    words, unit = _unit_of(re.sub(r"\[(\d+)\]", r"_\1", rest if own else name))
    label = re.sub(r"\W+", "_", words.strip()).strip("_").lower() or "signal"
    if name in inputs or name in outputs:
        return Heading(name, label, unit, "u" if name in inputs else "y")
    role = own or (name if name in ("u", "y") else _role(label))  # matrices u and y: inputs and outputs
    if role == "t" and unit and not same_dimension(unit, "s"):
        role = "aux"  # T_motor [°C]
    return Heading(name, rest if own and not unit else label, unit, role)


def _unit_of(name: str) -> tuple[str, str]:
    """Return a name without its unit, and the unit: in brackets, or what follows the last underscore if it is one.

    The quantity that is named decides between spellings: ``current_a`` is in A and not in years, ``torque_nm`` not in nanometres.
    """
    name = re.sub(r"_(rad|deg|[cm]?m)_s$", r"_\1/s", name)
    found = re.fullmatch(r"(.*?)\s*[\[(]([^\])]+)[\])]\s*", name) or re.fullmatch(rf"(.+)_(?!(?:{'|'.join(NO_UNITS)})$)([A-Za-z%][A-Za-z%/0-9]*)", name)
    stated = found.group(2) if found else ""
    quantity = next((unit for word, unit in QUANTITIES.items() if word in name.lower()), "")
    cases = map("".join, itertools.product(*((c.lower(), c.upper()) for c in stated[:3]))) if quantity and len(stated) <= 3 else ()
    spelt = [SPELT.get(u, u) for u in (stated, *cases)]
    unit = next((u for u in spelt if u and _is_unit(u) and _unit(u, name).dimensionality == _unit(quantity, name).dimensionality), "")
    unit = unit or next((u for u in (spelt[0], stated.lower()) if u and _is_unit(u)), "")  # SPEED_RPM is in rpm
    return (found.group(1), unit) if found and unit else (name, "")


def _is_unit(text: str) -> bool:
    try:
        return same_unit(text, text + "*1", text) or True
    except BadInput:
        return False


def same_dimension(a: str, b: str) -> bool:
    """Whether two units measure the same quantity; texts without a unit do."""
    return a == b or bool(a and b and _unit(a, "").dimensionality == _unit(b, "").dimensionality)


def _role(label: str) -> str:
    words = label.split("_")
    for role, known in (("t", TIMES), ("u", INPUTS), ("ref", REFERENCES), ("y", OUTPUTS)):
        if any(word in known for word in words):
            return role
    return "aux"


def role_of_unit(unit: str) -> str:
    """Return the role a quantity has in most logs, by its unit; "aux" where that says nothing.

    >>> role_of_unit("mV"), role_of_unit("rpm"), role_of_unit("degC")
    ('u', 'y', 'aux')
    """
    what = _unit(unit, "").dimensionality if unit else None
    return next((role for role, known in UNITS.items() if any(what == _unit(u, "").dimensionality for u in known)), "aux")
