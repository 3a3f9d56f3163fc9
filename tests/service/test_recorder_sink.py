"""Slow, failing and full sinks: detection never waits for them, and what they miss is counted and reported."""

from __future__ import annotations

import errno
import threading
import time

import numpy as np
import pytest

from afdsvc.api.evidence import Evidence
from afdsvc.api.signals import Block, Channel
from afdsvc.app.serve import SiteSinks
from afdsvc.files.recording.mcap_file import McapFile
from afdsvc.files.recording.reader import Recording
from afdsvc.files.recording.recorder import RecordingFailed
from afdsvc.files.site import RecordingSection as Settings
from afdsvc.files.site import parse_site
from afdsvc.service import recorder_sink
from afdsvc.service.clock import FastClock
from afdsvc.service.recorder_sink import PreAlarmBuffer, Receipts, RecorderSink
from afdsvc.service.sinks import FanOut, Publisher, ThreadedSink
from afdsvc.transport.outgoing_queue import OutgoingQueue
from afdsvc.wire import codec
from afdsvc.wire.codec import Message
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import EventKind, Finding, RigEvent


def block(seq: int = 0) -> Block:
    return Block("m1", "s1", seq, 50 * seq, 1e-3, 10**18 + seq, (Channel("u_x"), Channel("y_x")), np.ones((50, 2)))


class Slow:
    """A sink that takes its time, or never comes back."""

    def __init__(self, seconds: float = 0.0) -> None:
        self.seconds, self.taken, self.closed, self.begun = seconds, 0, False, threading.Event()

    def take(self, message):
        self.begun.set()
        time.sleep(self.seconds)
        self.taken += 1

    def tick(self):
        pass

    def close(self):
        self.closed = True


def test_a_slow_sink_holds_nobody_up_and_its_drops_are_counted_and_reported_once():
    reported: list[str] = []
    sink = ThreadedSink(Slow(0.2), "slow", reported.append, size=10)
    began = time.monotonic()
    for _ in range(500):
        sink.take(Message(block(), b""))
    assert time.monotonic() - began < 50  # waiting for it would take 98 s
    assert reported == ["10 messages wait; further ones are dropped until the queue has room"]
    sink.close(10)
    assert sink._sink.closed
    assert sink.dropped + sink._sink.taken == 500
    assert sink._sink.taken >= 10


def test_a_sink_that_hangs_does_not_hold_up_the_end():
    slow = Slow(60.0)
    sink = ThreadedSink(slow, "hung", lambda s: None, size=10)
    for _ in range(5):
        sink.take(Message(block(), b""))
    assert slow.begun.wait(30)
    began = time.monotonic()
    sink.leave()
    sink.close(0.3)
    assert time.monotonic() - began < 30
    assert sink.dropped == 4


def test_a_first_file_that_cannot_be_made_is_tried_as_rarely_as_any(tmp_path, monkeypatch):
    """Not on every message: a full or missing disk would be asked twenty times a second by each machine."""
    (tmp_path / "file").write_text("")
    tries, now = [], [0.0]
    monkeypatch.setattr(recorder_sink.time, "monotonic", lambda: now[0])
    sink = RecorderSink(Settings(folder=tmp_path / "file" / "r"), "m1", "", "", 10**18, {})
    begin = sink._begin
    monkeypatch.setattr(sink, "_begin", lambda: (tries.append(now[0]), begin())[1])
    for n in range(500):
        now[0] = 0.05 * n
        with pytest.raises(recorder_sink.RecordingFailed, match="cannot be made: Not a directory"):
            sink.take(Message(block(n), b""))
    assert tries == pytest.approx([0.0, 10.0, 20.0])
    assert sink.dropped == 500
    (tmp_path / "file").unlink()
    now[0] = 31.0
    sink.take(Message(block(500), codec.encode_block(block(500))))
    sink.close()
    assert len(list(Recording(sink.paths[0]).blocks())) == 1


@pytest.mark.parametrize("failing", ["tick", "event"])
def test_samples_lost_by_whatever_write_fails_are_not_acknowledged_when_the_next_file_begins(failing, tmp_path, monkeypatch):
    """A full disk is met by the flush of a tick, or of a message without samples, after which no block comes until a new file can be begun."""

    def full(file):
        raise OSError(errno.ENOSPC, "No space left on device")

    receipts = Receipts()
    sink = RecorderSink(Settings(folder=tmp_path), "m1", "", "", 0, {}, receipts)
    sink.take(Message(block(0)))
    sink._recorder._flushed = float("-inf")  # a flush is due
    with monkeypatch.context() as disk:
        disk.setattr(McapFile, "flush", full)
        with pytest.raises(RecordingFailed, match="No space left"):
            sink.tick() if failing == "tick" else sink.take(Message(RigEvent("m1", "s", 0, EventKind.NOTE, cause="a sentence")))
    sink._recorder._failed_at = float("-inf")  # it is time for a new file
    sink.take(Message(block(1)))
    sink._recorder._flushed = float("-inf")
    sink.tick()
    lost, kept = block(0), block(1)
    assert receipts.covers(kept.session, kept.k0, kept.k0 + len(kept))
    assert not receipts.covers(lost.session, lost.k0, lost.k0 + len(lost))
    sink.close()
    assert [b.k0 for path in sink.paths for b in Recording(path).blocks()] == [kept.k0]


def test_two_starts_in_one_second_do_not_fight_over_a_name(tmp_path):
    for n in range(3):
        sink = RecorderSink(Settings(folder=tmp_path), "m1", "", "", 10**18, {})
        sink.take(Message(block(n), codec.encode_block(block(n))))
        sink.close()
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"m1-20010909T014640{x}.mcap" for x in ("-2", "-3", "")]


def test_a_sender_never_waits_for_a_network_that_stands_still():
    gate = threading.Event()
    post = OutgoingQueue(lambda key, payload: gate.wait(60), size=10)
    began = time.monotonic()
    for _ in range(100):
        post.publish("k", b"x")
    assert post.dropped in (89, 90)
    assert post.waiting == 10
    post.close(0.2)
    assert time.monotonic() - began < 30  # the network stands still for 60 s
    gate.set()


def test_what_waits_is_sent_before_the_end_and_failures_are_counted():
    sent: list[bytes] = []

    def publish(key: str, payload: bytes) -> None:
        if payload == b"3":
            raise OSError("no route")
        sent.append(payload)

    post = OutgoingQueue(publish)
    for n in range(6):
        post.send("k", str(n).encode)
    post.close()
    assert sent == [b"0", b"1", b"2", b"4", b"5"]
    assert post.dropped == 1


def test_a_patient_post_loses_nothing():
    sent: list[bytes] = []
    post = OutgoingQueue(lambda key, payload: (time.sleep(0.002), sent.append(payload)), size=3, patient=True)
    for n in range(60):
        post.publish("k", bytes([n]))
    post.close()
    assert sent == [bytes([n]) for n in range(60)]
    assert post.dropped == 0


def test_memory_does_not_grow_while_nobody_takes():
    """A queue that is full stays as long as it is."""
    gate = threading.Event()
    post = OutgoingQueue(lambda *_: gate.wait(5), size=50)
    for _ in range(10_000):
        post.publish("k", bytes(100))
    assert post.waiting == 50
    gate.set()
    post.close(0.2)


def test_drops_anywhere_on_the_way_out_are_shown_in_the_status(tmp_path):
    """Recorder, black box, review, and what is sent to viewers: one figure, shown by `afdsvc status` and `/metrics`."""
    outlets = SiteSinks(parse_site(f'site = "t"\nrecording.folder = "{tmp_path}"\n[[machines]]\nid = "m"\nplant = "gas_bearing"', "x"), FastClock())
    post = OutgoingQueue(lambda key, payload: 1 / 0)
    outlets.posts.append(post)
    hung = ThreadedSink(Slow(60.0), "hung", lambda s: None, size=1)
    outlets._boxes.append(hung)
    for _ in range(5):
        post.publish("k", b"x")
        hung.take(Message(block(), b""))
    post.close()
    assert outlets.summary()[3] == 5 + hung.dropped
    assert hung.dropped >= 3


def test_a_decision_is_encoded_once_for_all_sinks(tmp_path, monkeypatch):
    encoded = []
    encode = codec.encode
    monkeypatch.setattr(codec, "encode", lambda value: (encoded.append(value), encode(value))[1])
    finding = Finding(Evidence("cusum", "m1", 1, 0.1, 1.0, 2.0, False), "s1", 10**18)
    recorder = RecorderSink(Settings(folder=tmp_path), "m1", "", "", 10**18, {})
    sent: list[bytes] = []
    post = OutgoingQueue(lambda key, payload: sent.append(payload))
    sinks = FanOut([recorder, PreAlarmBuffer(recorder.base, recorder.header), Publisher(Keys("hall"), post, post)])
    sinks.take(Message(finding))
    sinks.close()
    post.close()
    assert encoded == [finding]
    assert sent == [encode(finding)]
    assert list(Recording(recorder.paths[0]).findings()) == [finding]
