"""The contract between residuals and detectors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Protocol, TypeVar

import numpy as np

from afdsvc.api.bursts import Burst, Limits
from afdsvc.api.evidence import Evidence
from afdsvc.api.memo import Memo
from afdsvc.lti.lft import AugmentedPlant
from afdsvc.lti.statespace import Array, StateSpace

T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class FalseAlarms:
    """The promised alarm rate of one detector: per burst for burst detectors, per hour for those that run always."""

    per_burst: float = 1e-3
    per_hour: float = 1 / (24 * 30)


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """White noises per sample: ``output_cov (p, p)`` on the outputs, ``process_cov (n, n)`` on the states, ``cross_cov (n, p)`` of the two.

    ``samples`` counts those the noise was estimated from, 0 for stated noise.
    """

    output_cov: Array
    process_cov: Array | None = None
    cross_cov: Array | None = None
    samples: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class DetectionProblem:
    """Everything a detector may know when it is designed.

    ``plant`` is the nominal discrete plant G, ``augmented`` its LFT over the named faults (``fault_names``),
    ``interconnection`` the controller as J_K (inputs ``[y, alpha]``, outputs ``[u, beta]``), ``innovations`` the filter
    from ``[y; u]`` to the white residual r, ``covariance`` that of r, shape ``(p, p)``. ``residual_gain`` is the system
    from beta to r. ``output_names`` has length p, ``severity_range`` the bounds of every fault. ``limits`` are those of the
    rig (None when not stated): an actuator at its limit spoils a burst. ``uncertain`` is the same plant with its
    uncertain parameters pulled out, ``uncertainty`` their standard deviations by name, in the unit of its severities (a share of
    the parameter, or 1 where an entry of a matrix is counted in its standard deviations); None and empty for a model that is taken as certain. ``output_cov (p, p)``, ``process_cov (n, n)`` and ``cross_cov (n, p)`` are the noises the
    innovations were made from, where known: a parameter of A or C also moves the predictor's gain. ``noise_samples`` counts the samples
    they were estimated from (0: stated). ``speed`` [rad/s] is that of a machine that turns,
    0 otherwise. ``loop_known`` is False where no controller is stated: ``interconnection`` then belongs to one that stands in, and what
    the loop makes of an excitation is not known. ``through`` says where the excitation enters the ``interconnection``: "alpha", "input"
    (added to the controller's output) or "setpoint" (subtracted from what the controller sees).
    """

    machine: str
    plant: StateSpace
    augmented: AugmentedPlant
    interconnection: StateSpace
    innovations: StateSpace
    whitening: StateSpace
    covariance: Array
    output_names: tuple[str, ...]
    false_alarms: FalseAlarms
    input_names: tuple[str, ...] = ()
    severity_range: tuple[float, float] = (-1.0, 0.0)
    uncertainty: Mapping[str, float] = field(default_factory=dict)
    limits: Limits | None = None
    uncertain: AugmentedPlant | None = None
    output_cov: Array | None = None
    process_cov: Array | None = None
    speed: float = 0.0
    loop_known: bool = True
    cross_cov: Array | None = None
    noise_samples: int = 0
    through: str = "alpha"
    memo: Memo = field(default_factory=Memo, repr=False)

    def once(self, make: Callable[[], T], *key: object) -> T:
        """Return ``make()``, made once for all problems of this machine that differ in their false alarms only.

        ``key`` distinguishes it from everything else that is made for the machine; a promised rate that matters belongs to it.
        """
        return self.memo(make, *key, *(getattr(self, f.name) for f in fields(self) if f.name not in ("false_alarms", "memo")))

    @property
    def excitation_names(self) -> tuple[str, ...]:
        """Names of the excitation's columns."""
        return self.output_names if self.through == "setpoint" else self.input_names

    @property
    def fault_names(self) -> tuple[str, ...]:
        """Names of the faults, in the order of the LFT's diagonal."""
        return self.augmented.fault_names


@dataclass(frozen=True, slots=True, eq=False)
class ResidualBlock:
    """Consecutive samples for a detector: whitened residual ``r (n, p)``, ``beta (n, p)`` (empty when the machine has
    none), ``u (n, m)``, ``y (n, p)``, ``alpha (n, m)``, ``aux`` by label. ``burst`` is the burst playing (None when
    quiet), ``burst_start`` the index of its first sample. ``gap`` is True when samples are missing before this block:
    whatever was being accumulated must be thrown away. ``memo`` keeps what several detectors compute from the block.
    """

    k0: int
    dt: float
    r: Array
    beta: Array
    u: Array
    y: Array
    alpha: Array
    burst: Burst | None = None
    burst_name: str = ""
    burst_start: int = 0
    gap: bool = False
    aux: Mapping[str, Array] = field(default_factory=dict)
    memo: Memo = field(default_factory=Memo, init=False, repr=False)

    def __len__(self) -> int:
        return int(self.r.shape[0])


class Detector(Protocol):
    """A streaming detector: settings are frozen inside, state is a value, a step is a function.

    ``step`` must not modify its arguments; its cost per sample is constant and its state bounded.
    """

    @property
    def name(self) -> str:
        """Name under which evidence is reported."""
        ...

    def start(self) -> Any:
        """Return the initial state."""
        ...

    def step(self, state: Any, block: ResidualBlock) -> tuple[Any, Sequence[Evidence]]:
        """Return the state after the block and the decisions that fell inside it (usually none)."""
        ...


class DetectorDesign(Protocol):
    """What a detector plugin hands out: a name and a way to design the detector for one machine.

    One with ``passive = True`` judges quiet data, too: `diagnose` then counts a recording without bursts as tested.
    """

    name: str
    summary: str

    def design(self, problem: DetectionProblem, settings: Mapping[str, Any]) -> Detector:
        """Return a detector; raises `BadInput` naming a setting that is unknown or out of range."""
        ...


def empty(n: int) -> Array:
    """Return an array for a role the machine does not have, shape ``(n, 0)``."""
    return np.zeros((n, 0))
