"""The schema of MODEL.toml."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from afdsvc.files.validation import Strict

Matrix = list[list[float]]
Name = Annotated[str, Field(min_length=1, pattern=r"^\S(.*\S)?$")]
Positive = Annotated[float, Field(gt=0)]


class VariableTable(Strict):
    """An input or output."""

    name: Name
    unit: str = ""


class StateTable(VariableTable):
    """A state; ``rate_of`` names the state it is the time derivative of."""

    rate_of: Name | None = None


class ParameterTable(Strict):
    """A physical parameter and how well it is known."""

    value: float
    unit: str = ""
    relative_sd: Annotated[float, Field(ge=0)] = 0.05


class UncertaintyTable(Strict):
    """How well entries are known: one relative figure for all that are not 0 or +-1, or absolute, matrix by matrix."""

    relative: Annotated[float, Field(ge=0)] = 0.05
    A: Matrix | None = None
    B: Matrix | None = None
    C: Matrix | None = None
    D: Matrix | None = None


class NoiseTable(Strict):
    """Standard deviation of each output's noise; covariance of the noise that drives the states."""

    output_sd: list[Positive] | None = None
    process_cov: Matrix | None = None


class LinearTable(Strict):
    """Four matrices on one time base."""

    time: Literal["continuous", "discrete"]
    sample_time: Positive | None = None
    A: Matrix | None = None
    B: Matrix | None = None
    C: Matrix | None = None
    D: Matrix | None = None

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

    def missing(self) -> list[str]:
        """Return the names of the matrices that are not there."""
        return [name for name in "ABCD" if getattr(self, name) is None]


class ControllerTable(LinearTable):
    """The controller, positive feedback ``u = K (y - ref)``."""

    @model_validator(mode="after")
    def _complete(self) -> ControllerTable:
        if self.missing():
            raise ValueError(f"matrix {', '.join(self.missing())} is missing; expected A, B, C and D")
        return self


class PerturbationTable(Strict):
    """How the linear part of a simulator that only steps is looked for: pushes (in the inputs' units), samples, order."""

    amplitude: list[Positive] | None = None
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
        absent = self.missing()
        if self.dynamics is None and absent:
            raise ValueError(f"matrix {', '.join(absent)} is missing; expected A, B, C and D, or dynamics")
        if self.dynamics is not None and len(absent) < 4:
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
                raise ValueError(f"states: {found}; expected another state ({others})")
        return self
