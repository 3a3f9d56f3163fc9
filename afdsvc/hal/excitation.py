"""What adds to alpha beside the nominal controller: a burst being played, and Q."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from afdsvc.api.bursts import Burst, Limits
from afdsvc.api.retuning import Tuning
from afdsvc.errors import Refused
from afdsvc.hal import control_sample
from afdsvc.lti.stability import describe_pole, is_stable, worst_pole
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


MOST_STATES = 200  # of Q: more take longer than a control sample may


class RunningQ:
    """The state of Q in the control sample, ``q`` and ``motion`` of `afdsvc.hal.control_sample`, and what ends it."""

    def __init__(self, inputs: int, outputs: int, dt: float) -> None:
        self._m, self._p, self._dt = inputs, outputs, dt
        self.q, self.motion = control_sample.no_q(inputs, outputs)
        self._tuning: Tuning | None = None
        self._ask: Callable[[], str] = lambda: ""
        self._sum, self._samples = 0.0, 0
        self.ended_because = self.name = ""

    @property
    def acts(self) -> bool:
        """Whether Q adds to alpha, or is about to."""
        return bool(self.motion[0] > 0 or self.motion[3] > 0)

    @property
    def gain(self) -> float:
        """The gain of Q now."""
        return float(0.5 - 0.5 * np.cos(np.pi * self.motion[0]))

    def label(self, gains: Sequence[float]) -> str:
        """Return what a block is called in which the gain of Q took these values: "" without it, its name with all of it."""
        return "" if max(gains) == 0 else self.name if min(gains) == 1 else f"{self.name} moves"

    def check(self, tuning: Tuning) -> None:
        """Raise `Refused` when Q does not fit, is not stable, or another one acts."""
        Q = tuning.Q
        if self.acts:
            raise Refused("another Q acts; restore the machine first")
        if Q.D.shape != (self._m, self._p) or Q.dt != self._dt:
            raise Refused(f"Q is {Q.outputs} x {Q.inputs} at {Q.dt:g} s; expected {self._m} x {self._p} at {self._dt:g} s")
        if Q.order > MOST_STATES:
            raise Refused(f"Q has {Q.order} states; at most {MOST_STATES} fit into a control sample")
        if not all(np.isfinite(M).all() for M in (Q.A, Q.B, Q.C, Q.D)) or not is_stable(Q.A, Q.dt):
            raise Refused(f"Q is not stable; its pole is {describe_pole(worst_pole(np.nan_to_num(Q.A), Q.dt)[0], Q.dt)}")

    def begin(self, tuning: Tuning, reason_to_end: Callable[[], str], name: str) -> None:
        """Put Q in place, at rest; raises `Refused` as `check`, and where there is a reason to end it already."""
        self.check(tuning)
        reason = reason_to_end()
        if reason:
            raise Refused(f"{reason}, before the first sample")
        held = control_sample.contiguous_system(tuning.Q)
        self.q = held.A, held.B, held.C, held.D, np.zeros(held.order)
        steps = [1 / max(round(seconds / self._dt), 1) for seconds in (tuning.rise, tuning.fall)]
        self.motion = np.array([0.0, *steps, 1.0])
        self._tuning, self._ask, self.ended_because, self.name = tuning, reason_to_end, "", name
        self._sum, self._samples = 0.0, 0

    def end(self, reason: str) -> None:
        """Let the gain fall from the next sample on."""
        if self.acts and not self.ended_because:
            self.ended_because = reason
            self.motion[3] = -1.0

    def ask(self) -> None:
        """End Q where there is a reason outside the loop."""
        if self.acts and not self.ended_because:
            reason = self._ask()
            if reason:
                self.end(reason)

    def watch(self, u: Array, y: Array, cause: str, k: int, burst: bool) -> None:
        """Note why the control sample has ended Q; count the cost while it acts alone, and end Q where the promise is broken."""
        if self._tuning is None or self.ended_because:
            return
        if self.motion[3] <= 0:
            self.ended_because = f"{cause} at sample {k}"
            return
        promise = self._tuning.promise
        if promise is None or burst or self.motion[0] < 1:
            return
        self._sum += float(np.einsum("ni,ij,nj", y, promise.output, y) + np.einsum("ni,ij,nj", u, promise.input, u))
        self._samples += len(u)
        if self._samples * self._dt < promise.seconds:
            return
        measured = self._sum / self._samples
        self._sum, self._samples = 0.0, 0
        if not measured <= promise.cost:
            self.end(f"the measured cost is {measured:.4g} over {promise.seconds:g} s; at most {promise.cost:.4g} was promised")
