"""The audit log: every way to change a line is noticed, and what cannot be written is stated."""

from __future__ import annotations

import json
import multiprocessing
import os
import resource
import signal
from pathlib import Path

import pytest

from afdsvc.errors import BadInput
from afdsvc.service.audit_log import LOST, TORN, AuditLog, verify_chain
from afdsvc.service.clock import FastClock


def written(path: Path, count: int = 5, who: str = "kim") -> list[dict]:
    log = AuditLog(path, FastClock())
    for i in range(count):
        log.add(who, "pause", {"machine": f"m{i}"})
    log.close()
    return list(verify_chain(path).entries)


def test_what_is_added_is_there_in_order_over_restarts(tmp_path):
    path = tmp_path / "in" / "t-audit.jsonl"
    written(path)
    entries = written(path, 2, "lee")
    assert [(e["number"], e["who"], e["arguments"]["machine"]) for e in entries] == [
        *((i + 1, "kim", f"m{i}") for i in range(5)), (6, "lee", "m0"), (7, "lee", "m1"),
    ]  # fmt: skip
    assert path.stat().st_mode & 0o777 == 0o600


def resealed(line: bytes) -> bytes:
    """A line about another person, with a hash that fits it."""
    from afdsvc.service.audit_log import _seal

    entry = json.loads(line) | {"who": "lee"}
    return json.dumps({**entry, "hash": _seal(entry)}).encode()


ATTACKS = {
    "a person is replaced": lambda lines: [lines[0], lines[1].replace(b"kim", b"lee"), *lines[2:]],
    "and the line sealed anew": lambda lines: [lines[0], resealed(lines[1]), *lines[2:]],
    "a line is removed": lambda lines: [lines[0], *lines[2:]],
    "the first line is removed": lambda lines: lines[1:],
    "lines are exchanged": lambda lines: [lines[0], lines[2], lines[1], *lines[3:]],
    "a line is doubled": lambda lines: [lines[0], lines[0], *lines[1:]],
    "a key is hidden behind another": lambda lines: [lines[0].replace(b'{"number"', b'{"who": "lee", "number"'), *lines[1:]],
    "a line is rubbish": lambda lines: [lines[0], b"rubbish", *lines[1:]],
    "the last line is rubbish": lambda lines: [*lines, b"rubbish", b""],
    "a line is blank": lambda lines: [lines[0], b" ", *lines[1:]],
}


@pytest.mark.parametrize("attack", ATTACKS)
def test_a_line_that_is_changed_is_noticed(tmp_path, attack):
    path = tmp_path / "audit.jsonl"
    written(path)
    path.write_bytes(b"\n".join(ATTACKS[attack](path.read_bytes().split(b"\n"))))
    with pytest.raises(BadInput, match=r"audit.jsonl: line \d"):
        verify_chain(path)


def test_every_bit_counts(tmp_path):
    path = tmp_path / "audit.jsonl"
    written(path, 2)
    whole = path.read_bytes()
    for at in range(0, len(whole) - 1):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 4]) + whole[at + 1 :])
        with pytest.raises(BadInput):
            verify_chain(path)


def test_a_log_that_was_cut_or_made_anew_lacks_what_was_noted_elsewhere(tmp_path):
    path = tmp_path / "audit.jsonl"
    noted = written(path)[-1]["hash"]
    assert verify_chain(path, noted).number == 5
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:3]))
    assert verify_chain(path).number == 3
    with pytest.raises(BadInput, match="the log was cut, or made anew"):
        verify_chain(path, noted)


@pytest.mark.parametrize("kept", [1, 30, -2, -1])
def test_a_line_that_a_power_failure_cut_is_stated_by_the_next(tmp_path, kept):
    """Cut anywhere: one byte of the last line, some, all but its end, all but the line feed (then it is whole)."""
    path = tmp_path / "audit.jsonl"
    written(path, 3)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(lines[0] + lines[1] + lines[2][:kept])
    what = [e["what"] for e in written(path, 1)]
    assert what == ["pause", "pause", "pause", "pause"] if kept == -1 else ["pause", "pause", TORN, "pause"]


def test_lines_a_full_disk_does_not_take_are_counted(tmp_path):
    path = tmp_path / "audit.jsonl"
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    log, (soft, hard) = AuditLog(path, FastClock()), resource.getrlimit(resource.RLIMIT_FSIZE)
    log.add("kim", "pause")
    wait_until_sent(log)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 50, hard))
    try:
        for _ in range(3):
            log.add("kim", "resume")
        wait_until_sent(log)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    log.add("kim", "stop")
    log.close()
    entries = verify_chain(path).entries
    assert [e["what"] for e in entries] == ["pause", TORN, LOST, "stop"]
    assert entries[2]["arguments"] == {"count": 3}


def wait_until_sent(log: AuditLog) -> None:
    log._queue._queue.join()


def _many(path: str, who: str) -> None:
    written_by = AuditLog(Path(path), FastClock())
    for i in range(200):
        written_by.add(who, "pause", {"i": i})
    wait_until_sent(written_by)
    os._exit(0)


def test_two_services_that_write_at_once_keep_one_chain(tmp_path):
    path = tmp_path / "audit.jsonl"
    both = [multiprocessing.get_context("spawn").Process(target=_many, args=(str(path), who)) for who in ("kim", "lee")]
    for process in both:
        process.start()
    for process in both:
        process.join(60)
    entries = verify_chain(path).entries
    for who in ("kim", "lee"):
        assert [e["arguments"]["i"] for e in entries if e["who"] == who] == list(range(200))


def test_arguments_without_end_are_kept_as_their_hash(tmp_path):
    path = tmp_path / "audit.jsonl"
    log = AuditLog(path, FastClock())
    log.add("kim", "ack", {"comment": "x" * 10**6}, "y" * 10**6)
    log.close()
    (entry,) = verify_chain(path).entries
    assert set(entry["arguments"]) == {"sha256"}
    assert path.stat().st_size < 4000
