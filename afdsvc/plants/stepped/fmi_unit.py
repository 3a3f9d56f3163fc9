"""A simulator packed as an FMI 2 or 3 co-simulation unit, as a plant. Needs the extra ``fmi`` (FMPy).

The standard: https://fmi-standard.org. A unit is compiled code of a stranger; whoever opens one has decided to run it.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array
from afdsvc.plants.stepped.function_plant import finite_outputs

_REAL = ("Real", "Float64", "Float32")
_SETTABLE = ("parameter", "input", "structuralParameter")
_ABANDONED: list[Any] = []  # units that failed: their code may still hold what Python would free


@dataclass(frozen=True, slots=True)
class UnitDescription:
    """What a unit says of itself: names and units of its real inputs and outputs, its step [s] (None: not stated), its name."""

    name: str
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    step: float | None


def describe(path: Path) -> UnitDescription:
    """Return what a unit says of itself; raises `BadInput` for what is not a co-simulation unit of FMI 2 or 3."""
    described = _description(path)
    step = described.defaultExperiment.stepSize if described.defaultExperiment else None
    sides = [
        {v.name: _unit(v) for v in described.modelVariables if v.causality == side and v.type in _REAL} for side in ("input", "output")
    ]
    return UnitDescription(described.modelName, sides[0], sides[1], float(step) if step else None)


@dataclass
class FmiUnit:
    """A `SteppedPlant` around a unit. ``start`` sets parameters before it is initialised, ``watched`` are read as its states.

    Names are those of the unit. Raises `BadInput`, naming the file, for a variable that is not there or not of its kind.
    """

    path: Path
    inputs: Sequence[str]
    outputs: Sequence[str]
    start: Mapping[str, float] = field(default_factory=dict)
    watched: Sequence[str] = ()

    def __post_init__(self) -> None:
        self._described = _description(self.path)
        self._folder: str | None = None
        self._unit: Any = None
        self._time, self._said = 0.0, ""
        self._variables = {v.name: v for v in self._described.modelVariables}
        self._u = [self._reference(name, ("input",), "input") for name in self.inputs]
        self._y = [self._reference(name, ("output",), "output") for name in self.outputs]
        self._x = [self._reference(name, (), "variable") for name in self.watched]
        self._p = [(self._reference(name, _SETTABLE, "parameter"), float(value)) for name, value in self.start.items()]

    def begin(self) -> Array:
        """Make a new instance, initialise it, and return its outputs."""
        from fmpy import extract, instantiate_fmu

        self._free()
        try:
            self._folder = self._folder or extract(str(self.path))
            self._unit = instantiate_fmu(self._folder, self._described, "CoSimulation", logger=self._log)
            self._initialise()
            self._time = 0.0
            return self._outputs()
        except BadInput:
            raise
        except Exception as error:  # the unit's own failure, a library for another computer, a torn archive
            raise self._failure("cannot be started", error) from error

    def advance(self, u: Array, dt: float) -> Array:
        """Hold the inputs for ``dt`` and return the outputs at the end."""
        if self._unit is None:
            raise BadInput(f"simulator {self.path} has failed or is closed; it must be restarted")
        try:
            self._put(self._u, u.tolist())
            self._unit.doStep(currentCommunicationPoint=self._time, communicationStepSize=dt)
            self._time += dt
            return self._outputs()
        except BadInput:
            raise
        except Exception as error:
            raise self._failure(f"fails at {self._time:.6g} s", error) from error

    def states(self) -> Array:
        """Return the variables that are watched."""
        return np.array(self._get(self._x), dtype=np.float64) if self._x else np.zeros(0)

    def close(self) -> None:
        """End the instance and remove what was unpacked."""
        self._free()
        if self._folder:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    def _initialise(self) -> None:
        three = self._three
        if not three:
            self._unit.setupExperiment(startTime=0.0)
        for reference, value in self._p:
            self._put([reference], [value])
        self._unit.enterInitializationMode(**({"startTime": 0.0} if three else {}))
        self._unit.exitInitializationMode()

    def _free(self) -> None:
        unit, self._unit = self._unit, None
        if unit is not None:
            unit.terminate()
            unit.freeInstance()

    def _outputs(self) -> Array:
        return finite_outputs(np.array(self._get(self._y), dtype=np.float64), str(self.path))

    def _get(self, references: list[int]) -> list[float]:
        found: list[float] = (self._unit.getFloat64 if self._three else self._unit.getReal)(references)
        return found

    def _put(self, references: list[int], values: list[float]) -> None:
        (self._unit.setFloat64 if self._three else self._unit.setReal)(references, values)

    @property
    def _three(self) -> bool:
        return bool(self._described.fmiVersion.startswith("3"))

    def _reference(self, name: str, kinds: Sequence[str], what: str) -> int:
        variable = self._variables.get(name)
        if variable is None or (kinds and variable.causality not in kinds) or variable.type not in _REAL:
            there = [v.name for v in self._variables.values() if (not kinds or v.causality in kinds) and v.type in _REAL]
            raise BadInput(f"{self.path}: has no {what} '{name}'; it has {', '.join(there) or 'none'}")
        return int(variable.valueReference)

    def _log(self, *arguments: Any) -> None:
        """Keep the unit's last message, which is reported when the unit fails."""
        last = arguments[-1]
        self._said = last.decode(errors="replace") if isinstance(last, bytes) else str(last)

    def _failure(self, what: str, error: Exception) -> BadInput:
        """Return the sentence on a failure. The standard forbids every further call, freeing included, so its resources are not released."""
        if self._unit is not None:
            _ABANDONED.append(self._unit)
            self._unit = None
        why = (self._said or str(error) or type(error).__name__).strip().splitlines()
        return BadInput(f"simulator {self.path} {what}: {why[-1] if why else type(error).__name__}")


def _description(path: Path) -> Any:
    try:
        from fmpy import read_model_description
    except ImportError:
        raise BadInput(f"{path}: an FMI unit needs the extra 'fmi': install afdsvc[fmi]") from None
    if not path.is_file():
        raise BadInput(f"{path}: cannot be read: no such file")
    try:
        found = read_model_description(str(path), validate=False)
    except Exception as error:
        raise BadInput(f"{path}: is not a readable FMI unit: {(str(error) or type(error).__name__).splitlines()[0]}") from None
    if not found.fmiVersion.startswith(("2", "3")):
        raise BadInput(f"{path}: is a unit of FMI {found.fmiVersion}; expected FMI 2 or 3")
    if found.coSimulation is None:
        raise BadInput(f"{path}: offers no co-simulation, only an integrator could run it; expected a co-simulation unit")
    return found


def _unit(variable: Any) -> str:
    return str(variable.unit or (variable.declaredType.unit if variable.declaredType else "") or "")
