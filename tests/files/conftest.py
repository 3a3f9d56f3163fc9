"""A small synthetic machine: what a rig would send, reproducible, with a burst and an event."""

from collections.abc import Callable

import numpy as np
import pytest

from afdsvc.api.evidence import Evidence, Severity
from afdsvc.api.signals import Block, Channel
from afdsvc.files.recording.mcap_file import Header
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.wire.codec import encode, encode_block
from afdsvc.wire.messages import EventKind, Finding, RigEvent

CHANNELS = (Channel("u_x", "V"), Channel("y_x", "um"), Channel("alpha_x", "V"), Channel("beta_x", "um"))
T0 = 1_763_000_000_000_000_000
DT, LENGTH = 1e-3, 50


def machine_blocks(count: int, machine: str = "m1", session: str = "s1", seed: int = 0) -> list[Block]:
    """Return consecutive blocks of noise; every fourth is played to by a burst."""
    rng = np.random.default_rng(seed)
    return [
        Block(
            machine, session, seq, seq * LENGTH, DT, T0 + round(seq * LENGTH * DT * 1e9), CHANNELS,
            rng.normal(size=(LENGTH, len(CHANNELS))), "b1" if seq % 4 == 1 else "",
        )
        for seq in range(count)
    ]  # fmt: skip


def machine_event(k: int = LENGTH, kind: EventKind = EventKind.BURST_STARTED) -> RigEvent:
    return RigEvent("m1", "s1", T0 + round(k * DT * 1e9), kind, k, "b1", "asked for by the scheduler")


def machine_finding(k: int = 2 * LENGTH, detected: bool = True) -> Finding:
    fault, severity = ("horizontal_actuator", Severity(-0.5, 0.02)) if detected else (None, None)
    e = Evidence(
        "matched_filter", "m1", k, k * DT, 41.7, 9.2, detected, "b1", "x", fault, severity, {"horizontal_actuator": 1.0}
    )
    return Finding(e, "s1", T0 + round(k * DT * 1e9))


@pytest.fixture
def blocks() -> Callable[..., list[Block]]:
    return machine_blocks


@pytest.fixture
def record(tmp_path):
    """Yield a function that records blocks, one event and one decision, and returns the path."""
    opened = []

    def write(name="run.mcap", count=12, close=True, flush_each=False, **settings):
        header = Header("[site]\nname='plant'", {"m1": "model text"}, {"site": "plant"})
        recorder = Recorder(RecordingSettings(tmp_path / name, **settings), header, monotonic=lambda: 0.0)
        for block in machine_blocks(count):
            recorder.block(encode_block(block), block)
            if block.seq == 1:
                recorder.event(encode(machine_event()), machine_event())
            if block.seq == 2:
                recorder.finding(encode(machine_finding()), machine_finding())
            if flush_each:
                recorder.flush()
        opened.append(recorder)
        if close:
            recorder.close()
        return recorder.path

    yield write
    for recorder in opened:
        recorder.close()


@pytest.fixture
def an_event():
    return machine_event


@pytest.fixture
def a_finding():
    return machine_finding
