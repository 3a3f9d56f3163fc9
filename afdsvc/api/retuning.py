"""The contract of retuning: what was diagnosed, what the loop is to minimise, and what a retuner hands out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from afdsvc.api.detection import DetectionProblem
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array, StateSpace


@dataclass(frozen=True, slots=True)
class DiagnosedFault:
    """A fault of the machine and the interval its severity lies in, ``low <= high`` (-1 is total loss, 0 healthy).

    >>> DiagnosedFault("horizontal_actuator", -0.55, -0.45).middle
    -0.5
    """

    fault: str
    low: float
    high: float

    def __post_init__(self) -> None:
        if not self.low <= self.high:
            raise BadInput(f"fault '{self.fault}': severities from {self.low:g} to {self.high:g}; expected the larger loss first, as in {self.high:g}..{self.low:g}")

    @property
    def middle(self) -> float:
        """The middle of the interval."""
        return (self.low + self.high) / 2


@dataclass(frozen=True, slots=True, eq=False)
class LoopCost:
    """The quadratic cost ``E[x' state x + u' input u]`` per sample, and the noises that cause it.

    ``state (n, n)`` and ``input (m, m)`` are weights, ``process (n, n)`` and ``noise (p, p)`` covariances per sample of white noise on
    the states and on the outputs. The states are those of the nominal plant, so a failing sensor hides no cost.
    """

    state: Array
    input: Array
    process: Array
    noise: Array


@dataclass(frozen=True, slots=True, eq=False)
class Promise:
    """What the loop with Q must measure: the mean of ``y' output y + u' input u`` over ``seconds`` is at most ``cost``.

    ``output (p, p)`` and ``input (m, m)`` weight what sensors report and actuators get; samples of bursts do not count.
    """

    output: Array
    input: Array
    cost: float
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class Tuning:
    """Q ``(m, p)`` from beta to alpha as a rig runs it; its gain rises over ``rise`` and falls over ``fall`` seconds (0: one sample)."""

    Q: StateSpace
    rise: float
    fall: float
    promise: Promise | None = None


class RetunerDesign(Protocol):
    """What a retuner plugin hands out: a way to choose Q for a damaged machine. It proposes; `afdsvc.retune.proof` decides."""

    name: str
    summary: str

    def design(self, problem: DetectionProblem, found: DiagnosedFault, cost: LoopCost, settings: Mapping[str, Any]) -> StateSpace:
        """Return a stable Q ``(m, p)`` from beta to alpha; raises `Refused` where nothing is gained, `BadInput` for a setting."""
        ...
