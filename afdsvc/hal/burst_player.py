"""The waveform being played: started, taken slice by slice, faded out or cut."""

from __future__ import annotations

import numpy as np

from afdsvc.api.bursts import Burst, Limits
from afdsvc.errors import Refused
from afdsvc.lti.statespace import Array

SHORTEST_FADE, LONGEST_FADE = 0.02, 1.0  # seconds: no jerk where a burst has no ramp, no long goodbye where it has a slow one
MOST_WORK = 2e8  # lines times samples: a few seconds of computing; longer ones are better sent as a waveform


class BurstPlayer:
    """Alpha as a queue of samples. Empty, it yields zeros for ever."""

    def __init__(self, inputs: int) -> None:
        self._rest = np.zeros((0, inputs))
        self._fade = 0
        self.name = ""
        self.ended_because = ""

    @property
    def playing(self) -> bool:
        """Whether samples are still to come."""
        return len(self._rest) > 0

    @property
    def left(self) -> int:
        """Number of samples still to come."""
        return len(self._rest)

    def start(self, burst: Burst, dt: float, limits: Limits) -> None:
        """Queue a burst; raises `Refused` when one is playing or a limit of alpha or duration would be broken."""
        if self.playing:
            raise Refused(f"burst '{self.name}' is playing; only one burst is played at a time")
        refuse_burst(burst, dt, limits)
        self._rest = burst.play(dt)
        self._fade = round(min(max(burst.ramp * dt, SHORTEST_FADE), LONGEST_FADE) / dt)
        self.name, self.ended_because = burst.name, ""

    def take(self, n: int) -> Array:
        """Return the next ``n`` samples, shape ``(n, inputs)``; never more than are left while playing."""
        taken, self._rest = self._rest[:n].copy(), self._rest[n:]
        return taken

    def cut(self, reason: str) -> None:
        """Drop the remaining samples at once (a limit was met: alpha is already zero)."""
        self._rest = self._rest[:0]
        self.ended_because = reason

    def fade_out(self, reason: str) -> None:
        """End over the burst's own ramp (within `SHORTEST_FADE` and `LONGEST_FADE`), from wherever it is now."""
        n = min(self._fade, len(self._rest))
        gate = 0.5 + 0.5 * np.cos(np.pi * (np.arange(n) + 1) / max(n, 1))
        self._rest = self._rest[:n] * gate[:, None]
        self.ended_because = self.ended_because or reason


def refuse_burst(burst: Burst, dt: float, limits: Limits) -> None:
    """Raise `Refused` with the reason when a burst does not fit the limits of alpha, inputs and duration."""
    if burst.inputs != len(limits.alpha):
        raise Refused(f"burst '{burst.name}' has {burst.inputs} inputs; this machine has {len(limits.alpha)}")
    seconds = burst.samples * dt
    if seconds > limits.seconds:
        raise Refused(f"burst '{burst.name}' lasts {seconds:.3g} s; at most {limits.seconds:.3g} s are allowed")
    if len(burst.lines) * burst.samples > MOST_WORK:
        found = f"{len(burst.lines)} lines over {burst.samples} samples"
        raise Refused(f"burst '{burst.name}' has {found}; at most {MOST_WORK:.0g} products are computed, send a waveform instead")
    with np.errstate(over="ignore", invalid="ignore"):
        alpha = burst.play(dt)
    if not np.isfinite(alpha).all():
        raise Refused(f"burst '{burst.name}' contains NaN or infinity; expected finite samples")
    for i, (peak, bound) in enumerate(zip(np.abs(alpha).max(axis=0), limits.alpha, strict=True)):
        if peak > bound:
            raise Refused(f"burst '{burst.name}' reaches {peak:.3g} on alpha {i}; at most {bound:.3g} is allowed")
