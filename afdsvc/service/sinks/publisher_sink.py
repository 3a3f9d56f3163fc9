"""A sink that publishes findings for viewers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter

from afdsvc.transport.outgoing_queue import OutgoingQueue
from afdsvc.wire.codec import Message
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import AlarmChange, Finding, Residual

_payload = attrgetter("payload")  # encoded in the thread of the queue, unless another sink has


@dataclass
class Publisher:
    """Publishes residuals and decisions of one machine; blocks and events are on the wire already.

    Residuals go by ``stream``, where only the newest matter, decisions and alarms by ``post``; neither waits for a viewer.
    """

    keys: Keys
    post: OutgoingQueue
    stream: OutgoingQueue
    heard: Callable[[str], bool] = lambda key: True

    def take(self, message: Message) -> None:
        """Publish a residual when anybody looks at it, a decision, or what happened to an alarm."""
        match message.value:
            case Residual(block):
                if self.heard(self.keys.residual(block.machine)):
                    self.stream.send(self.keys.residual(block.machine), _payload, message)
            case Finding(evidence):
                self.post.send(self.keys.evidence(evidence.machine), _payload, message)
            case AlarmChange(alarm):
                self.post.send(self.keys.alarm(alarm.machine), _payload, message)

    def tick(self) -> None:
        """Nothing."""

    def close(self) -> None:
        """Nothing: the posts are closed by whoever opened them."""
