"""When a burst is played: periodically with jitter, on request, after an event; never in quiet hours, never without rest."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from datetime import datetime, time

import numpy as np

from afdsvc.diagnosis.verdict import Question
from afdsvc.errors import Refused
from afdsvc.files.site import Bursts


@dataclass(frozen=True, slots=True)
class BurstOrder:
    """A burst somebody wants: why, at which second of the machine's own time (at once when None), what for, and, for a burst
    that is to isolate a fault, the question it answers."""

    reason: str
    at: float | None = None
    purpose: str = "diagnose"
    question: Question | None = None


class Scheduler:
    """Decides for one machine. Times are seconds of the machine's own samples; quiet hours use local wall time."""

    def __init__(self, settings: Bursts, rng: np.random.Generator, now: float) -> None:
        self._settings, self._rng = settings, rng
        self._next = None if settings.every_seconds is None else now + settings.first_after_seconds
        self._last_end = float("-inf")
        self._queue: list[BurstOrder] = []
        self._followed: deque[str] = deque(maxlen=64)  # bursts whose question has had its second burst
        self.playing = False
        self.paused = ""

    def machine_appeared(self, now: float) -> None:
        """Start the period anew: a machine that has just begun first shows how it is without excitation.

        Its samples count from 0 again, so a time noted in its last session means nothing.
        """
        self._last_end = min(self._last_end, now)
        if self._next is not None:
            self._next = now + self._settings.first_after_seconds

    def request(self, order: BurstOrder, now: float, wall: datetime) -> None:
        """Queue a burst asked for by a person; raises `Refused` with the reason when it cannot be played now."""
        if self.paused:
            raise Refused(f"bursts are paused: {self.paused}")
        if self.playing:
            raise Refused("a burst is playing; only one burst is played at a time")
        if self.quiet(wall):
            raise Refused(f"it is {wall:%H:%M}, within the quiet hours of this machine")
        rest = self._last_end + self._settings.rest_seconds - now
        if rest > 0:
            raise Refused(f"the pause after the last burst lasts another {rest:.1f} s")
        self._queue.append(order)

    def after_event(self, reason: str) -> None:
        """Queue a burst because of an event, when the site wants that; it waits for rest and quiet hours."""
        if self._settings.after_event and not self._queue:
            self._queue.append(BurstOrder(f"after event: {reason}"))

    def follow_up(self, question: Question) -> None:
        """Queue the burst that separates the two likeliest faults of a question, once per question (two-step isolation)."""
        self.settle(question.burst)
        if self._settings.isolate and question.burst not in self._followed:
            self._queue.append(BurstOrder(str(question), purpose="isolate", question=question))

    def settle(self, burst: str) -> None:
        """Drop what was to follow a burst that has answered its own question after all."""
        self._queue = [w for w in self._queue if w.question is None or w.question.burst != burst]

    def due(self, now: float, wall: datetime) -> BurstOrder | None:
        """Return the burst to play now, or None."""
        if self.paused or self.playing or self.quiet(wall) or now < self._last_end + self._settings.rest_seconds:
            return None
        if self._queue:
            return self._taken(self._queue.pop(0))
        if self._next is not None and now >= self._next:
            planned = self._next
            self._plan(planned, now)
            return BurstOrder("periodic", at=planned)
        return None

    def _taken(self, order: BurstOrder) -> BurstOrder:
        if order.question is not None:
            self._followed.append(order.question.burst)
        return order

    def seconds_to_next(self, now: float) -> float:
        """Return the seconds until the next periodic burst, 0 when none is planned or it is due."""
        return 0.0 if self._next is None or self.paused else max(self._next - now, 0.0)

    def started(self) -> None:
        """Note that a burst began."""
        self.playing = True

    def ended(self, now: float) -> None:
        """Note that a burst ended or was refused; rest begins."""
        self.playing, self._last_end = False, now

    def quiet(self, wall: datetime) -> bool:
        """Whether the wall time lies in a quiet interval; an interval may span midnight."""
        return any(_within(wall.time(), start, stop) for start, stop in self._settings.quiet_hours)

    def _plan(self, planned: float, now: float) -> None:
        """Set the next time from the planned one, so that the times do not depend on when somebody looked."""
        every, jitter = self._settings.every_seconds or 0.0, self._settings.jitter_seconds
        self._next = max(planned + max(every + jitter * self._rng.uniform(-1, 1), 0.0), now)


def _within(t: time, start: time, stop: time) -> bool:
    return start <= t < stop if start <= stop else (t >= start or t < stop)
