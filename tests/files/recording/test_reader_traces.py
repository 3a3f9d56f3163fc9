"""Blocks put together: nothing invented across a gap, a restart or a change of channels."""

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.signals import Channel
from afdsvc.errors import BadInput
from afdsvc.files.recording.reader import traces_of


def shape(traces):
    return [(t.notes["session"], int(t.notes["k0"]), len(t), int(t.notes["lost"])) for t in traces]


def test_an_uninterrupted_stream_is_one_trace(blocks):
    found = blocks(6)
    [trace] = traces_of(found, "run.mcap", t0=2.0)
    assert trace.values.tobytes() == np.vstack([b.values for b in found]).tobytes()
    assert (trace.dt, trace.t0, trace.name, trace.channels) == (1e-3, 2.0, "run.mcap", found[0].channels)
    assert trace.notes["t0_ns"] == str(found[0].t0_ns)


def test_a_gap_splits_and_its_size_is_noted(blocks):
    found = blocks(8)
    del found[5], found[2:4]
    traces = traces_of(found, "r")
    assert shape(traces) == [("s1", 0, 100, 0), ("s1", 200, 50, 100), ("s1", 300, 100, 50)]
    assert [t.t0 for t in traces] == [0.0, 0.2, 0.3]


def test_sessions_machines_and_channels_are_kept_apart(blocks):
    other_rig = blocks(2, machine="m2", seed=1)
    restarted = blocks(2, session="s2", seed=2)
    rewired = [replace(b, channels=(Channel("u_z"), *b.channels[1:])) for b in blocks(4)[2:]]
    slower = [replace(b, dt=0.5) for b in blocks(6)[4:]]
    traces = traces_of([*blocks(2), *other_rig, *restarted, *rewired, *slower], "r")
    assert [(t.notes["machine"], t.notes["session"], t.channels[0].name, t.dt) for t in traces] == [
        ("m1", "s1", "u_x", 1e-3), ("m2", "s1", "u_x", 1e-3), ("m1", "s2", "u_x", 1e-3),
        ("m1", "s1", "u_z", 1e-3), ("m1", "s1", "u_x", 0.5),
    ]  # fmt: skip


def test_late_and_repeated_blocks_find_their_place(blocks):
    found = blocks(5)
    shuffled = [found[0], found[3], found[1], found[2], found[1], found[4]]
    [trace] = traces_of(shuffled, "r")
    assert trace.values.tobytes() == np.vstack([b.values for b in found]).tobytes()


def test_two_rigs_under_one_name_are_refused(blocks):
    with pytest.raises(BadInput, match=r"machine 'm1', session 's1': blocks 0 and 0 both hold sample 0"):
        traces_of([*blocks(2), *blocks(2, seed=9)], "r")


def test_nothing_gives_nothing():
    assert traces_of([], "r") == []
