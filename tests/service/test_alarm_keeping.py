"""Alarms over restarts, the minute before them in a file, and those who are notified: none may hold up or take down the rest."""

from __future__ import annotations

import json
import os
import sqlite3
import threading
from contextlib import suppress
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, HTTPServer

import numpy as np
import pytest

from afdsvc.api.evidence import Evidence, Severity
from afdsvc.api.signals import Block, Channel
from afdsvc.app.serve import open_outboxes
from afdsvc.diagnosis.alarm_book import AlarmBook, Policy
from afdsvc.errors import BadInput
from afdsvc.files.recording.mcap_file import Header
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import parse_site
from afdsvc.plugins.manager import load
from afdsvc.service.notifications import History, NotificationQueue
from afdsvc.service.operator_requests import json_values
from afdsvc.service.recorder_sink import PreAlarmBuffer
from afdsvc.service.standby import handed_over, taken_over
from afdsvc.service.webhook import Webhook
from afdsvc.wire import codec
from afdsvc.wire.codec import Message
from afdsvc.wire.messages import Alarm, AlarmChange, AlarmKind, Finding

SECOND = 1_000_000_000
CHANGE = AlarmChange(Alarm("m/a", "m", "a", SECOND, SECOND), "raised", SECOND, why="because")


def said(t: int = 0, detected: bool = True) -> Finding:
    fault = "a" if detected else None
    return Finding(Evidence("x", "m", 0, 0.0, 9.0, 4.0, detected, fault=fault, severity=Severity(-0.5, 0.1)), "s", t * SECOND)


def test_a_second_service_keeps_every_change_once_and_in_order(tmp_path):
    first, second = History(tmp_path / "first.sqlite"), History(tmp_path / "second.sqlite")
    book = AlarmBook(Policy(clear_after=2), first.add)
    book.take(said(1))
    second.merge(taken_over(handed_over(first)))
    book.acknowledge("m/a", "kim", "seen", 2 * SECOND)
    acknowledged = first.changes()[-1]
    second.merge([acknowledged])
    second.merge(taken_over(handed_over(first)))
    assert second.changes() == first.changes()
    assert second.last() == first.last()
    assert second.last()[0].acknowledged_by == "kim"
    for t in range(1500):  # more than are handed over; the last change of every alarm is among them all the same
        first.add(replace(acknowledged, t_ns=(10 + t) * SECOND, alarm=replace(acknowledged.alarm, id="m/b")))
    third = History(tmp_path / "third.sqlite")
    third.merge(taken_over(handed_over(first)))
    assert third.last() == first.last()


def test_alarms_and_what_people_did_survive_a_restart(tmp_path):
    history = History(tmp_path / "alarms.sqlite")
    before = AlarmBook(Policy(clear_after=2), history.add)
    before.take(said(1))
    before.acknowledge("m/a", "kim", "seen", 2 * SECOND)
    before.condition("m", "frozen_sensor", AlarmKind.SYSTEM, True, "still", 3 * SECOND)
    after = AlarmBook(Policy(clear_after=2), history.add)
    after.restore(history.last(), 9 * SECOND)
    assert after.alarms["m/a"] == before.alarms["m/a"]
    assert after.alarms["m/a"].acknowledged_by == "kim"
    assert not after.alarms["m/frozen_sensor"].active
    after.take(said(10, detected=False))
    assert after.alarms["m/a"].active
    after.take(said(11, detected=False))
    assert not after.alarms["m/a"].active
    assert [(c.event, c.who) for c in history.changes("m/a")] == [("raised", ""), ("acknowledged", "kim"), ("ended", "")]


def test_old_changes_are_forgotten_but_never_how_an_alarm_stands(tmp_path):
    history = History(tmp_path / "alarms.sqlite")
    book = AlarmBook(Policy(), history.add)
    for t in range(4):
        book.take(said(t))
        book.acknowledge("m/a", "kim", str(t), t * SECOND)
    assert history.forget(100 * SECOND) == 4
    assert history.last() == [book.alarms["m/a"]]


def test_a_history_that_is_no_database_is_named(tmp_path):
    path = tmp_path / "alarms.sqlite"
    path.write_bytes(b"this is not a database, whatever its name says" * 40)
    with pytest.raises(BadInput, match=r"alarms\.sqlite: the alarm history cannot be used: file is not a database"):
        History(path).last()


def test_a_change_is_on_the_disk_when_add_returns(tmp_path):
    path = tmp_path / "alarms.sqlite"
    History(path).add(CHANGE)
    rows = sqlite3.connect(path).execute("SELECT alarm, event, why FROM change").fetchall()
    assert rows == [("m/a", "raised", "because")]


def block(k: int, n: int = 100) -> Block:
    channels = (Channel("u_x", "V"), Channel("y_x", "um"))
    values = np.full((n, 2), float(k))
    return Block("m", "s", seq=k, k0=k * n, t0_ns=k * n * SECOND // 100, dt=0.01, channels=channels, values=values)


def test_the_black_box_holds_the_minute_before_and_nothing_older(tmp_path):
    box = PreAlarmBuffer(tmp_path / "alarms" / "m", Header("site", {"m": "model"}, {"machine": "m"}), seconds=60.0)
    for k in range(200):
        b = block(k)
        box.take(Message(b, codec.encode_block(b)))
    box.take(Message(said(199)))
    box.take(Message(AlarmChange(Alarm("m/a", "m", "a", 199 * SECOND, 199 * SECOND), "raised", 199 * SECOND, why="because")))
    (path,) = box.paths
    recording = Recording(path)
    assert recording.loss == ""
    assert [b.k0 // 100 for b in recording.blocks("m")] == list(range(139, 200))
    assert len(list(recording.findings("m"))) == 1
    for change in ("acknowledged", "ended"):
        box.take(Message(AlarmChange(CHANGE.alarm, change, SECOND)))
    assert len(box.paths) == 1


@pytest.mark.parametrize("step", [-7200, -60, 86400])
def test_a_step_of_the_rigs_clock_does_not_make_the_black_box_grow(tmp_path, step):
    payload = codec.encode_block(block(0))
    box = PreAlarmBuffer(tmp_path / "m", Header(), seconds=10.0)
    for k in range(100):
        box.take(Message(block(10_000 + k), payload))
    for k in range(100):
        box.take(Message(block(10_100 + step + k), payload))
    assert len(box._said) == 11


def test_the_black_box_does_not_grow_beyond_its_bytes(tmp_path):
    payload = codec.encode_block(block(0))
    box = PreAlarmBuffer(tmp_path / "m", Header(), seconds=1e6, most_bytes=10 * len(payload))
    for k in range(1000):
        box.take(Message(block(k), payload))
    assert len(box._said) == 10


def test_an_outbox_tries_again_and_then_gives_up_and_counts(caplog):
    heard, calls = [], []

    def receive(change):
        calls.append(change)
        if len(calls) < 3 or change.event == "ended":
            raise OSError("no route")
        heard.append(change.event)

    outbox = NotificationQueue("test", receive, pauses=(0.0, 0.0))
    outbox.put(CHANGE)
    outbox.put(AlarmChange(CHANGE.alarm, "ended", 2))
    assert outbox.flush(5)
    assert heard == ["raised"]
    assert (outbox.dropped, outbox.failure) == (1, "OSError: no route")
    assert "m/a (ended) could not be delivered to test: OSError: no route" in caplog.text
    outbox.close()


def test_a_full_disk_makes_no_alarm_forgotten_however_long_it_is_full(tmp_path, caplog):
    if os.geteuid() != 0 or os.system(f"mount -t tmpfs -o size=200k none {tmp_path} 2>/dev/null") != 0:
        pytest.skip("no right to mount a small disk here")
    try:
        history, ballast = History(tmp_path / "alarms.sqlite"), tmp_path / "ballast"
        with ballast.open("wb", buffering=0) as file, suppress(OSError):
            while True:
                file.write(bytes(4096))
        box = NotificationQueue("the history", history.add, pauses=(0.01,), patient=True)
        box.put(CHANGE)
        box.put(replace(CHANGE, event="acknowledged", alarm=replace(CHANGE.alarm, acknowledged_by="kim")))
        assert not box.flush(0.5)
        assert "disk is full" in box.failure
        ballast.unlink()
        assert box.flush(5)
        assert [alarm.acknowledged_by for alarm in history.last()] == ["kim"]
        assert (box.dropped, box.failure) == (0, "")
        assert caplog.text.count("tried again until it is over") == 1
        box.close()
    finally:
        os.system(f"umount {tmp_path}")


def test_a_receiver_that_hangs_holds_nobody_up(caplog):
    release = threading.Event()
    outbox = NotificationQueue("test", lambda change: release.wait(20), size=2)
    for _ in range(10):
        outbox.put(CHANGE)
    assert outbox.dropped >= 7
    assert not outbox.flush(0.1)
    release.set()
    outbox.close()


class Ear(BaseHTTPRequestHandler):
    heard: list[tuple[str, dict]]

    def do_POST(self):
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.heard.append((self.headers.get("Authorization", ""), json.loads(body)))
        self.send_response(204)
        self.end_headers()

    def log_message(self, *args):
        pass


def test_a_webhook_posts_the_change_and_takes_its_secret_from_the_environment(monkeypatch):
    Ear.heard = []
    server = HTTPServer(("127.0.0.1", 0), Ear)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    monkeypatch.setenv("TOKEN", "Bearer s3cret")
    settings = {"url": f"http://127.0.0.1:{server.server_port}/x", "headers_from_environment": {"Authorization": "TOKEN"}}
    Webhook().open(settings)(json_values(CHANGE))
    Webhook().open({**settings, "events": ["ended"]})(json_values(CHANGE))
    server.shutdown()
    server.server_close()
    ((token, reported),) = Ear.heard
    assert token == "Bearer s3cret"
    assert (reported["event"], reported["why"], reported["alarm"]["id"]) == ("raised", "because", "m/a")


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({}, "an address that begins with http"),
        ({"url": "file:///etc/passwd"}, "an address that begins with http"),
        ({"url": "http://kim:secret@host/"}, "url holds a user or password"),
        ({"url": "http://host/", "token": "x"}, "unknown setting 'token'; known are url"),
        ({"url": "http://host/", "headers_from_environment": {"A": "NOT_SET_ANYWHERE"}}, "'NOT_SET_ANYWHERE' is not set"),
    ],
)
def test_wrong_settings_of_a_webhook_are_named_and_no_secret_is_repeated(settings, sentence):
    with pytest.raises(BadInput, match=sentence) as refusal:
        Webhook().open(settings)
    assert "secret" not in str(refusal.value)


def test_three_thousand_changes_at_once_are_all_in_the_history(tmp_path):
    site, history = parse_site('site = "t"\n[[machines]]\nid = "m"\nplant = "gas_bearing"\n', "site.toml"), History(tmp_path / "alarms.sqlite")
    (outbox,) = open_outboxes(site, history, load())
    for i in range(3000):
        outbox.put(replace(CHANGE, t_ns=SECOND + i))
    assert outbox.flush(30)
    outbox.close()
    assert outbox.dropped == 0
    assert [c.t_ns - SECOND for c in history.changes(limit=5000)] == list(range(3000))
