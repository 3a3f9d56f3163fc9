"""The control loop shared by simulator and hardware: blocks cut at the edges of bursts, arming, counters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from afdsvc.api.bursts import Burst, Limits
from afdsvc.api.clock import Clock
from afdsvc.api.port import PortStatus
from afdsvc.api.retuning import Tuning
from afdsvc.api.signals import Block, Channel
from afdsvc.errors import BadInput, Refused
from afdsvc.hal import control_sample
from afdsvc.hal.excitation import BurstPlayer, RunningQ, refuse_burst
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace

CAUSES = {
    control_sample.OUTPUT_LIMIT: "an output reached its limit",
    control_sample.INPUT_LIMIT: "an actuator reached its limit",
    control_sample.BAD_SAMPLE: "a sensor returned NaN, or a reading outside its range",
    control_sample.RESET: "the controller's state was no longer finite: it was reset, and the actuators brought to rest",
}
PLAUSIBLE = 1000.0  # times an output's limit: no reading of a working sensor lies beyond


@dataclass(frozen=True, slots=True)
class LoopSettings:
    """How a control loop is cut into blocks: ``block`` samples a message, ``slice`` samples between two looks at the clock.

    ``sensor_range`` is the largest plausible magnitude of each output's reading; None: `PLAUSIBLE` times its limit.
    """

    machine: str
    session: str
    block: int = 250
    slice: int = 50
    sensor_range: Sequence[float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """How a burst will show in a healthy machine: ``system`` from alpha to ``[u; y]``, ``noise (p,)`` the peak to add to y."""

    system: StateSpace
    noise: Array


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """What one run of the loop produced: u, y, beta, alpha with n rows each, extra columns, cause and place of an abort."""

    u: Array
    y: Array
    beta: Array
    alpha: Array
    aux: Array
    cause: int
    at: int

    def values(self) -> Array:
        """Return all columns in the order of the channels."""
        return np.hstack([self.u, self.y, self.alpha, self.beta, self.aux])


class ControlLoop(ABC):
    """A machine in closed loop with a controller in J_K form; subclasses say how a run of samples comes about.

    ``interconnection`` is J_K with inputs ``[y, alpha]`` and outputs ``[u, beta]``.
    """

    def __init__(
        self,
        interconnection: StateSpace,
        channels: tuple[Channel, ...],
        limits: Limits,
        settings: LoopSettings,
        clock: Clock,
        prediction: Prediction | None = None,
    ) -> None:
        self.m, self.p = len(limits.input), len(limits.output)
        if (interconnection.inputs, interconnection.outputs) != (self.p + self.m, self.m + self.p):
            raise BadInput(
                f"J_K is {interconnection.outputs} x {interconnection.inputs}; "
                f"expected {self.m + self.p} x {self.p + self.m} for {self.m} inputs and {self.p} outputs"
            )
        control_sample.compile_loops()
        self._K = control_sample.contiguous_system(interconnection)
        self._xk = np.zeros(interconnection.order)
        self._u = np.zeros(self.m)
        self._channels, self._limits, self._settings, self._clock = channels, limits, settings, clock
        self._prediction = prediction
        self._tuning = RunningQ(self.m, self.p, interconnection.dt)
        self._range = PLAUSIBLE * limits.output if settings.sensor_range is None else np.array(settings.sensor_range, dtype=float)
        if self._range.shape != limits.output.shape:
            raise BadInput(f"key 'limits.sensor_range' has {self._range.size} values; expected {self.p}, one per output")
        self._excitation = BurstPlayer(self.m)
        self._armed: Limits | None = None
        self._ready: deque[Block] = deque()
        self._k = self._seq = self._late = 0
        self._start_ns: int | None = None
        self._start: float | None = None
        self._busy = 0.0
        self._head_room = 1.0
        self._closed = False

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels of every block."""
        return self._channels

    @property
    def dt(self) -> float:
        """Sample time in seconds."""
        return self._K.dt

    def status(self) -> PortStatus:
        """Return the counters."""
        return PortStatus(self._k, self._late, self._head_room)

    def close(self) -> None:
        """Bring the machine to rest; harmless when called twice."""
        self._closed = True

    def read(self) -> Block | None:
        """Return the next block; blocks are cut where a burst starts or ends, so none spans such an edge."""
        if self._closed:
            return None
        if not self._ready:
            self._ready.extend(self._next_blocks())
        return self._ready.popleft() if self._ready else None

    def check(self, burst: Burst, limits: Limits) -> None:
        """Raise `Refused` when the burst would break a limit in a healthy machine; nothing moves."""
        bounds = _tightest(self._limits, limits)
        refuse_burst(burst, self.dt, bounds)
        if self._prediction is not None:
            _refuse_prediction(burst, self.dt, bounds, self._prediction)

    def check_tuning(self, tuning: Tuning) -> None:
        """Raise `Refused` when Q cannot run here: it does not fit, is not stable, or another one acts."""
        if self._closed:
            raise Refused("the machine is closed")
        if np.abs(self._K.D[self.m :, self.p :]).max(initial=0.0) > 0:
            raise Refused("alpha reaches beta in the same sample (the plant has a direct term); Q cannot run beside this controller")
        self._tuning.check(tuning)

    def retune(self, tuning: Tuning, reason_to_end: Callable[[], str] = lambda: "", name: str = "Q") -> None:
        """Let Q act from the next sample on; its gain rises from rest over ``tuning.rise``. Blocks bear its ``name``.

        ``reason_to_end`` is asked before every slice; what it returns ends Q (a lost lease, say). A limit met, a measured cost above the
        promise and `restore` end it too. Raises `Refused` as `check_tuning`.
        """
        self.check_tuning(tuning)
        self._tuning.begin(tuning, reason_to_end, name)

    def restore(self, reason: str) -> None:
        """Let the gain of Q fall from the next sample on, over the time its tuning states; harmless when none acts."""
        self._tuning.end(reason)

    @property
    def retuned(self) -> float:
        """Gain of Q, 0 when none acts."""
        return self._tuning.gain

    @property
    def restored_because(self) -> str:
        """Why the last Q ended, "" while one acts or before the first."""
        return self._tuning.ended_because

    @contextmanager
    def arm(self, limits: Limits) -> Iterator[_Drive]:
        """Hand out the drive; whatever happens inside, alpha is zero and the nominal controller on afterwards."""
        if self._armed is not None:
            raise Refused("the machine is armed already; one drive at a time")
        if self._closed:
            raise Refused("the machine is closed")
        self._armed = _tightest(self._limits, limits)
        try:
            yield _Drive(self)
        finally:
            if self._excitation.playing:
                self._excitation.cut(self._excitation.ended_because or "disarmed")
            self._armed = None

    @abstractmethod
    def _run(self, alpha: Array, limits: Limits | None) -> Samples:
        """Run the loop for the samples of alpha."""

    def _next_blocks(self) -> list[Block]:
        """Run until a block is full or a burst ends; an abort inside splits it in two."""
        name = self._excitation.name if self._excitation.playing else ""
        n = min(self._settings.block, self._excitation.left) if name else self._settings.block
        parts: list[Samples] = []
        late0, done, edge, gains = self._late, 0, n, [self._tuning.gain]
        while done < n:
            step = min(self._settings.slice, n - done)
            alpha = self._excitation.take(step) if name and edge == n else np.zeros((step, self.m))
            self._tuning.ask()
            part = self._paced(alpha)
            self._tuning.watch(part.u, part.y, CAUSES.get(part.cause, ""), self._k - step + part.at, bool(name))
            if part.cause != control_sample.NO_CAUSE and edge == n and name:
                edge = done + part.at
                self._excitation.cut(f"{CAUSES[part.cause]} at sample {self._k - step + part.at}")
            parts.append(part)
            gains.append(self._tuning.gain)
            done += step
        return self._cut(np.vstack([s.values() for s in parts]), edge, (name, self._tuning.label(gains)), self._late - late0)

    def _cut(self, values: Array, edge: int, names: tuple[str, str], late: int) -> list[Block]:
        burst, tuning = names
        pieces = [(0, edge, burst), (edge, len(values), "")] if edge < len(values) else [(0, len(values), burst)]
        k0 = self._k - len(values)
        return [self._block(values[a:b], k0 + a, (label, tuning), late if b == len(values) else 0) for a, b, label in pieces if b > a]

    def _block(self, values: Array, k0: int, names: tuple[str, str], late: int) -> Block:
        assert self._start_ns is not None  # noqa: S101 - set by _paced before any block exists
        stamp = self._start_ns + round(k0 * self.dt * 1e9)
        s = self._settings
        block = Block(s.machine, s.session, self._seq, k0, self.dt, stamp, self._channels, values, names[0], late, names[1])
        self._seq += 1
        return block

    def _plausible(self, y: Array) -> Array:
        """Return the readings ``y (p,)`` with NaN, a missing reading, in place of what no working sensor returns."""
        readings: Array = control_sample.plausible(y, self._range)
        return readings

    def _begin(self) -> float:
        """Return when the first sample was due, in seconds of the clock; the first call says now."""
        if self._start is None:
            self._start, self._start_ns = self._clock.monotonic(), self._clock.now_ns()
        return self._start

    def _paced(self, alpha: Array) -> Samples:
        """Run one slice when it is due; count its samples as late when it ends more than a slice after its due time."""
        clock, start = self._clock, self._begin()
        n = len(alpha)
        due = start + (self._k + n) * self.dt
        clock.sleep_until(due)
        began = clock.monotonic()
        samples = self._run(alpha, self._armed if self._excitation.name else None)
        ended = clock.monotonic()
        self._k += n
        self._late += n if ended > due + self._settings.slice * self.dt else 0
        self._busy += (ended - began - self._busy) * min(1.0, n * self.dt)
        self._head_room = 1 - self._busy / (n * self.dt)
        return samples


class _Drive:
    """The right to excite, valid inside ``arm`` only."""

    def __init__(self, loop: ControlLoop) -> None:
        self._loop = loop

    def play(self, burst: Burst) -> None:
        """Start the burst at the next sample; raises `Refused` with the reason."""
        loop = self._loop
        if loop._armed is None:  # noqa: SLF001 - the drive is the loop's own hand
            raise Refused("the drive has ended; arm the machine again")
        loop._excitation.start(burst, loop.dt, loop._armed)  # noqa: SLF001

    def stop(self, reason: str) -> None:
        """End the burst smoothly."""
        self._loop._excitation.fade_out(reason)  # noqa: SLF001

    @property
    def playing(self) -> bool:
        """Whether samples of the burst are still to come."""
        return self._loop._excitation.playing  # noqa: SLF001

    @property
    def aborted(self) -> str:
        """Why the burst was cut short; "" when it was not."""
        return self._loop._excitation.ended_because  # noqa: SLF001


def _refuse_prediction(burst: Burst, dt: float, limits: Limits, prediction: Prediction) -> None:
    """Raise `Refused` when the nominal model says the burst drives an input or output beyond its limit."""
    response, _ = simulate(prediction.system, burst.play(dt))
    peak = np.abs(response).max(axis=0)
    m = len(limits.input)
    for i, (found, bound) in enumerate(zip(peak[:m], limits.input, strict=True)):
        if found > bound:
            raise Refused(f"burst '{burst.name}' would drive input {i} to {found:.3g}; its limit is {bound:.3g}")
    for i, (found, bound) in enumerate(zip(peak[m:] + prediction.noise, limits.output, strict=True)):
        if found > bound:
            raise Refused(f"burst '{burst.name}' would drive output {i} to {found:.3g} with noise; its limit is {bound:.3g}")


def _tightest(a: Limits, b: Limits) -> Limits:
    """Return the tighter of two sets of limits, entry by entry; raises `Refused` when their shapes differ."""
    if (a.output.shape, a.input.shape) != (b.output.shape, b.input.shape):
        raise Refused(f"limits for {b.output.size} outputs and {b.input.size} inputs do not fit this machine")
    return Limits(
        np.minimum(a.output, b.output),
        np.minimum(a.input, b.input),
        np.minimum(a.alpha, b.alpha),
        min(a.seconds, b.seconds),
    )
