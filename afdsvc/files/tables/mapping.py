"""A mapping file: which column or topic of a foreign recording is which signal, in what unit, on what time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field, field_validator, model_validator

from afdsvc.api.signals import Channel
from afdsvc.errors import BadInput
from afdsvc.files.validation import Strict, read_text, toml_table, validated

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
    """The sample time [s] (default: the model's, or that of the slowest signal, without), and what counts as a gap, in samples."""

    dt: Positive | None = None
    gap: Annotated[float, Field(gt=1.05)] = 1.5


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
