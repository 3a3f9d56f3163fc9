"""One full message of every kind as bytes, with its decoder."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from afdsvc.api.bursts import Burst, Limits, Line
from afdsvc.api.evidence import Evidence, Severity
from afdsvc.api.signals import Block, Channel
from afdsvc.wire import codec
from afdsvc.wire.messages import (
    Alarm,
    AlarmChange,
    AlarmKind,
    BurstReply,
    BurstRequest,
    BurstStop,
    Command,
    CommandReply,
    EventKind,
    Finding,
    Lease,
    MachineStatus,
    Receipt,
    RigDescription,
    RigEvent,
    ServiceStatus,
)

T = 1_763_000_000_000_000_001
_CHANNELS = (Channel("u_x", "V"), Channel("y_x", "um"))
_BLOCK = Block("m1", "s1", 3, 60, 1e-3, T, _CHANNELS, np.arange(40.0).reshape(20, 2), "b1", 1)
_SINES = Burst("b1", 2, 1000, 50, (Line(0, 640.0, 0.1), Line(1, 641.0, 0.2, 0.3)), settle=10, notes={"reason": "x"})
_WAVE = Burst("w", 2, 3, 1, waveform=np.array([[0.1, 0.0], [1.0, 1e-300], [3.0, 4.0]]))
_EVIDENCE = Evidence(
    "matched_filter", "m1", 123, 0.1, 41.7, 9.2, True, "b1", "x", "horizontal_actuator", Severity(-0.5, 0.02), {"a": 0.9, "b": 0.1},
    True, "", 0.4, {"amplitude": 0.3},
)  # fmt: skip
_ALARM = Alarm("a1", "m1", "horizontal_actuator", T, T + 5, 3, True, Severity(-0.5, 0.1), True, "kim", "seen", AlarmKind.SYSTEM)
_MACHINE = MachineStatus("m1", "stale", "s1", "no block for 3 s", 10, 1, 2, 0.7, 3.0, "b1", 12.5, False, (_ALARM,))
_LIMITS = Limits(np.array([10.0]), np.array([9.0]), np.array([0.5]))
_VALUES: tuple[Any, ...] = (
    BurstRequest("m1", _SINES, 2.0, "scheduler", T),
    BurstRequest("m1", _WAVE, 2.0, "scheduler", T, 7),
    BurstReply(False, "b1", "already playing"),
    BurstStop("m1", "asked to", "kim", "b1"),
    Lease("m1", "b1", 2.0),
    Receipt("m1", (("s0", 5, 9), ("s1", 0, 2**40))),
    RigEvent("m1", "s1", T, EventKind.BURST_ABORTED, 77, "b1", "a limit"),
    RigDescription("m1", "s1", T, 2e-4, _CHANNELS, _LIMITS, "lqg", "s", "m", "1", "sim"),
    Finding(_EVIDENCE, "s1", T),
    AlarmChange(_ALARM, "raised", T, "kim", "because"),
    ServiceStatus("hall", "0.1", T, 5.0, (_MACHINE,), "r.mcap", 100, "", 2),
    Command("ack", {"alarm": "a1", "comment": "seen"}, "kim"),
    CommandReply(True, {"a": [1, 2.5, None]}),
)
EXAMPLES: tuple[tuple[Callable[[bytes], Any], bytes], ...] = (
    (codec.decode_block, codec.encode_block(_BLOCK)), *((partial(codec.decode, type(value)), codec.encode(value)) for value in _VALUES),
)
