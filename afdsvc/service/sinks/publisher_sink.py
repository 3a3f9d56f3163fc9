"""A sink that publishes findings for viewers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from afdsvc.api.signals import Block, residual_block
from afdsvc.lti.statespace import Array
from afdsvc.transport.outgoing_queue import OutgoingQueue
from afdsvc.wire import codec
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import AlarmChange, BurstRequest, Finding, RetuneRequest, RigEvent


@dataclass
class Publisher:
    """Publishes residuals and decisions of one machine; blocks and events are on the wire already.

    Residuals go by ``stream``, where only the newest matter, decisions and alarms by ``post``; neither waits for a viewer.
    """

    keys: Keys
    post: OutgoingQueue
    stream: OutgoingQueue
    heard: Callable[[str], bool] = lambda key: True

    def block(self, block: Block, payload: bytes) -> None:
        """Nothing: the rig published it."""

    def residual(self, block: Block, residual: Array) -> None:
        """Publish the whitened residual, when anybody looks at it."""
        if self.heard(self.keys.residual(block.machine)):
            self.stream.send(self.keys.residual(block.machine), codec.encode_block, residual_block(block, residual))

    def finding(self, finding: Finding) -> None:
        """Publish a decision."""
        self.post.send(self.keys.evidence(finding.evidence.machine), codec.encode, finding)

    def event(self, event: RigEvent, payload: bytes) -> None:
        """Nothing: the rig published it."""

    def request(self, request: BurstRequest | RetuneRequest) -> None:
        """Nothing: the rig is asked directly."""

    def notice(self, machine: str, level: str, sentence: str, t_ns: int) -> None:
        """Nothing: sentences go to the recording and the log."""

    def alarm(self, change: AlarmChange) -> None:
        """Publish what happened to an alarm."""
        self.post.send(self.keys.alarm(change.alarm.machine), codec.encode, change)

    def tick(self) -> None:
        """Nothing."""

    def close(self) -> None:
        """Nothing: the posts are closed by whoever opened them."""
