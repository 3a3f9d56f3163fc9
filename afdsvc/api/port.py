"""The contract of the hardware abstraction: what can be watched, and what can also be driven.

Capability is a type: everything is a `Port`; only what can be excited is a `DrivablePort`, and excitation exists only
inside ``with port.arm(limits) as drive``. Every exit from that block leaves alpha at zero and the nominal controller on.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from afdsvc.api.bursts import Burst, Limits
from afdsvc.api.retuning import Tuning
from afdsvc.api.signals import Block, Channel


@dataclass(frozen=True, slots=True)
class PortStatus:
    """Counters of a port since it was opened: samples, control samples that missed their deadline, and head-room.

    ``head_room`` is the share of the sample period the control loop did not use (1 idle, 0 full), over the last second.
    """

    samples: int
    late: int
    head_room: float


@runtime_checkable
class Port(Protocol):
    """A machine that can be watched."""

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels of every block this port returns."""
        ...

    @property
    def dt(self) -> float:
        """Sample time in seconds."""
        ...

    def read(self) -> Block | None:
        """Return the next block, waiting for it when the port runs in real time; None when there is no more."""
        ...

    def status(self) -> PortStatus:
        """Return the counters."""
        ...

    def close(self) -> None:
        """Release the machine; harmless when called twice."""
        ...


class Drive(Protocol):
    """The right to excite a machine, alive only inside `DrivablePort.arm`."""

    def play(self, burst: Burst) -> None:
        """Start the burst at the next sample; raises `Refused` when a limit would be broken or one is playing."""
        ...

    def stop(self, reason: str) -> None:
        """End the burst smoothly, over its ramp."""
        ...

    @property
    def playing(self) -> bool:
        """Whether samples of the burst are still to come."""
        ...

    @property
    def aborted(self) -> str:
        """Why the burst was cut short by a limit or by `stop`; "" when it was not."""
        ...


@runtime_checkable
class DrivablePort(Port, Protocol):
    """A machine that can be excited."""

    def check(self, burst: Burst, limits: Limits) -> None:
        """Raise `Refused` with the reason when the burst would break a limit of a healthy machine; nothing moves."""
        ...

    def arm(self, limits: Limits) -> AbstractContextManager[Drive]:
        """Return the drive as a context manager; raises `Refused` when the machine is not fit to be excited."""
        ...


@runtime_checkable
class SimulatedPort(Port, Protocol):
    """A machine that only exists in a simulator, so that faults can be put into it while it runs."""

    def inject(self, fault: str, severity: float) -> None:
        """Give a fault this severity (0: none) from the next samples on; any thread may call. Raises `BadInput` for an unknown fault."""
        ...


@runtime_checkable
class TunablePort(Port, Protocol):
    """A machine beside whose controller a Q can run. Its blocks bear the name of the Q that acts."""

    def check_tuning(self, tuning: Tuning) -> None:
        """Raise `Refused` when Q cannot run here; nothing moves."""
        ...

    def retune(self, tuning: Tuning, reason_to_end: Callable[[], str], name: str) -> None:
        """Let Q act from the next sample on, until there is a reason to end it or the loop finds one; raises `Refused`."""
        ...

    @property
    def retuned(self) -> float:
        """Gain of Q, 0 when none acts."""
        ...

    @property
    def restored_because(self) -> str:
        """Why the last Q ended, "" while one acts or before the first."""
        ...
