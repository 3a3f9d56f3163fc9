"""Signals: channels with roles and units, blocks of samples, and whole traces."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array

ROLES = ("u", "y", "alpha", "beta", "ref", "aux")


@dataclass(frozen=True, slots=True)
class Channel:
    """One measured signal. The role is the part of the name before the first underscore: ``u_force``, ``y_position``."""

    name: str
    unit: str = ""

    def __post_init__(self) -> None:
        if self.name.split("_", 1)[0] not in ROLES or "_" not in self.name:
            expected = ", ".join(f"{r}_<name>" for r in ROLES)
            raise BadInput(f"column '{self.name}' has no role; expected a name like {expected}")

    @property
    def role(self) -> str:
        """One of `ROLES`: u input, y output, alpha excitation, beta residual, ref reference, aux anything else."""
        return _parts(self.name)[0]

    @property
    def label(self) -> str:
        """The name without its role."""
        return _parts(self.name)[1]


@lru_cache(maxsize=4096)  # asked for every channel of every block
def _parts(name: str) -> tuple[str, str]:
    role, _, label = name.partition("_")
    return role, label


def of_role(channels: Iterable[Channel], role: str) -> list[int]:
    """Return the column numbers of the channels with this role, in order."""
    return [i for i, c in enumerate(channels) if c.role == role]


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Consecutive samples of one machine.

    ``values`` has shape ``(n samples, n channels)``. ``k0`` is the index of the first sample since the rig started
    (``session`` names that start), ``seq`` counts blocks without gaps, ``t0_ns`` is the Unix time of the first sample.
    ``burst`` names the burst playing during this block ("" when none); a block never spans the edge of a burst.
    ``late`` counts the control samples of this block that missed their deadline. ``tuning`` names the Q that acts in the whole block,
    with its full gain ("" when none); a block in which its gain moves bears another name.
    """

    machine: str
    session: str
    seq: int
    k0: int
    dt: float
    t0_ns: int
    channels: tuple[Channel, ...]
    values: Array
    burst: str = ""
    late: int = 0
    tuning: str = ""

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or self.values.shape[1] != len(self.channels):
            raise BadInput(
                f"block {self.seq} of machine '{self.machine}' holds an array of shape {self.values.shape}; "
                f"expected (samples, {len(self.channels)} channels)"
            )

    def __len__(self) -> int:
        return len(self.values)

    def role(self, role: str) -> Array:
        """Return the samples of one role, shape ``(n, channels of that role)``."""
        return self.values[:, of_role(self.channels, role)]

    def column(self, name: str) -> Array:
        """Return one channel by name, shape ``(n,)``; raises `BadInput` when it is missing."""
        for i, c in enumerate(self.channels):
            if c.name == name:
                return self.values[:, i]
        raise BadInput(f"block has no channel '{name}'; it has {', '.join(c.name for c in self.channels)}")


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """A recording in memory: uniformly sampled, without gaps. `load` makes them from files.

    Parameters
    ----------
    name : str
        Where it came from.
    dt : float
        Sample time in seconds.
    channels : tuple of Channel
        Names with roles (``u_voltage``, ``y_speed``) and units, a channel for each column.
    values : array (n, channels)
        The samples.
    t0 : float
        Time of the first sample in seconds.
    notes : dict of str to str
        What was done to the recording when it was read.

    Examples
    --------
    >>> import numpy as np
    >>> from afdsvc.api.signals import Channel, Trace
    >>> run = Trace("run", 0.1, (Channel("u_voltage", "V"), Channel("y_speed", "rad/s")), np.ones((50, 2)))
    >>> len(run), float(run.t[-1]), run.column("y_speed").shape, run.role("u").shape
    (50, 4.9, (50,), (50, 1))
    """

    name: str
    dt: float
    channels: tuple[Channel, ...]
    values: Array
    t0: float = 0.0
    notes: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or self.values.shape[1] != len(self.channels):
            raise BadInput(f"{self.name}: shape {self.values.shape} does not fit {len(self.channels)} channels")

    def __len__(self) -> int:
        return len(self.values)

    @property
    def t(self) -> Array:
        """Times of the samples in seconds, shape ``(n,)``."""
        return np.asarray(self.t0 + self.dt * np.arange(len(self)), dtype=np.float64)

    def role(self, role: str) -> Array:
        """Return the samples of one role, shape ``(n, channels of that role)``."""
        return self.values[:, of_role(self.channels, role)]

    def has(self, name: str) -> bool:
        """Whether the trace holds a channel of this name."""
        return any(c.name == name for c in self.channels)

    def column(self, name: str) -> Array:
        """Return one channel by name, shape ``(n,)``; raises `BadInput` with the likeliest other name when it is missing."""
        names = [c.name for c in self.channels]
        if name in names:
            return self.values[:, names.index(name)]
        alike = [n for n in names if n.partition("_")[0] == name.partition("_")[0]]
        cure = f"; --map {alike[0]}={name} (rename=) takes {alike[0]} for it" if len(alike) == 1 else f"; expected it under that name, or --map COLUMN={name} (rename=)"
        raise BadInput(f"{self.name}: no column '{name}'; it has {', '.join(names)}{cure}")

    def span(self, start: int, stop: int) -> Trace:
        """Return samples ``start`` to ``stop`` (exclusive) as a trace of its own."""
        return Trace(self.name, self.dt, self.channels, self.values[start:stop], self.t0 + start * self.dt, self.notes)


def residual_block(block: Block, residual: Array) -> Block:
    """Return the whitened residual as a block of its own, channels ``aux_r_<output>`` in the outputs' units."""
    channels = tuple(Channel(f"aux_r_{c.label}", c.unit) for c in block.channels if c.role == "y")
    return replace(block, channels=channels, values=residual, late=0)
