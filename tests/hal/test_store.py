"""The rig's store: nothing that was not acknowledged is lost, up to the stated size, and what does not fit is stated."""

from __future__ import annotations

import io
import os
import zlib
from pathlib import Path

import numpy as np
import pytest

from afdsvc.api.signals import Block, Channel
from afdsvc.errors import Refused
from afdsvc.hal import store as module
from afdsvc.hal.store import AGAIN_SECONDS, DELIVER_SECONDS, SPILL_SECONDS, Store
from afdsvc.service.clock import FastClock
from afdsvc.wire import codec
from afdsvc.wire.messages import Receipt

MANY = 1e9


def block(seq: int, session: str = "s1", n: int = 100) -> Block:
    values = np.random.default_rng(seq).standard_normal((n, 2))
    return Block("m1", session, seq, n * seq, 1e-3, 10**8 * seq, (Channel("u_x"), Channel("y_x")), values)


class Service:
    """Takes what is delivered and acknowledges when asked to."""

    def __init__(self, store: Store) -> None:
        self.store, self.taken = store, []

    def take(self, data: bytes) -> None:
        self.taken.append(codec.decode_block(data))

    def acknowledge(self, *samples: tuple[str, int, int]) -> None:
        self.store.receive(Receipt("m1", samples))


def passing(clock: FastClock, seconds: float) -> None:
    clock.sleep_until(clock.monotonic() + seconds)


def outage(folder, clock: FastClock, blocks: int = 20, most: float = MANY) -> Store:
    """Return a store that has kept blocks through an outage."""
    store = Store(folder, "m1", most, clock)
    for seq in range(blocks):
        store.encode(block(seq))
    passing(clock, SPILL_SECONDS + 1)
    store.tick(pytest.fail)
    return store


def after(store: Store, clock: FastClock, *samples: tuple[str, int, int]) -> Service:
    """Return a service that came back, after one delivery."""
    passing(clock, DELIVER_SECONDS + AGAIN_SECONDS)
    service = Service(store)
    service.acknowledge(*samples)
    store.tick(service.take)
    return service


def test_what_is_acknowledged_in_time_never_touches_the_disk(tmp_path):
    clock = FastClock()
    store = Store(tmp_path / "store", "m1", MANY, clock)
    for seq in range(100):
        store.encode(block(seq))
        passing(clock, 0.1)
        store.receive(Receipt("m1", (("s1", 0, 100 * seq + 100),)))
        store.tick(pytest.fail)
    assert not list((tmp_path / "store").iterdir())


def test_a_store_has_one_agent_at_a_time(tmp_path):
    first, second, other = (Store(tmp_path / "store", machine, MANY, FastClock()) for machine in ("m1", "m1", "m2"))
    first.claim()
    with pytest.raises(Refused, match=r"machine 'm1' has a rig agent already: it holds .*m1\.lock"):
        second.claim()
    other.claim()
    first.close()
    second.claim()
    for store in (second, other):
        store.close()


def test_an_outage_is_delivered_to_the_last_bit_and_forgotten_when_it_is_acknowledged(tmp_path):
    clock = FastClock()
    store = outage(tmp_path, clock)
    assert store.waiting > 0
    service = after(store, clock, ("s1", 0, 300))  # the publisher's memory has delivered three
    assert [b.seq for b in service.taken] == list(range(3, 20))
    assert all(np.array_equal(b.values, block(b.seq).values) for b in service.taken)
    store.tick(pytest.fail)  # not again at once
    service.acknowledge(("s1", 0, 2000))
    store.tick(pytest.fail)
    assert store.waiting == 0
    assert not list(tmp_path.iterdir())


def test_what_was_delivered_and_not_acknowledged_is_delivered_again(tmp_path):
    clock = FastClock()
    store = outage(tmp_path, clock)
    after(store, clock, ("s1", 0, 100))
    service = after(store, clock, ("s1", 0, 1900))
    assert [b.seq for b in service.taken] == [19]


def test_what_is_measured_during_a_long_delivery_goes_to_the_disk(tmp_path):
    """A process that is killed meanwhile loses the last seconds only."""
    clock = FastClock()
    store = outage(tmp_path, clock, 3)
    passing(clock, DELIVER_SECONDS + 1)
    store.receive(Receipt("m1", ()))
    taken = []

    def slowly(data: bytes) -> None:
        taken.append(codec.decode_block(data).seq)
        store.encode(block(10 + len(taken)))
        passing(clock, SPILL_SECONDS + 1)

    store.tick(slowly)
    assert taken == [0, 1, 2]
    assert {p.name for p in tmp_path.iterdir()} == {"m1.0000000000.blocks", "m1.0000000001.blocks"}
    assert [s[1] for s, _ in module.blocks(tmp_path / "m1.0000000001.blocks")] == [1100, 1200, 1300]


def test_without_a_service_that_acknowledges_nothing_is_delivered(tmp_path):
    clock = FastClock()
    store = outage(tmp_path, clock)
    passing(clock, 10 * DELIVER_SECONDS)
    store.tick(pytest.fail)


def test_a_rig_that_is_stopped_or_killed_in_the_outage_delivers_after_its_next_start(tmp_path):
    clock = FastClock()
    first = outage(tmp_path, clock, 5)
    first.encode(block(5))
    first.close()
    second = Store(tmp_path, "m1", MANY, clock)
    second.encode(block(0, "s2"))
    second.tick(pytest.fail)
    assert [(b.session, b.seq) for b in after(second, clock, ("s2", 0, 100)).taken] == [("s1", i) for i in range(6)]


@pytest.mark.parametrize("cut", [1, 7, 8, 500])
def test_a_record_that_a_power_failure_cut_costs_itself_only(tmp_path, cut):
    clock = FastClock()
    outage(tmp_path, clock, 5)
    (path,) = tmp_path.iterdir()
    os.truncate(path, path.stat().st_size - cut)
    assert [b.seq for b in after(Store(tmp_path, "m1", MANY, clock), clock).taken] == [0, 1, 2, 3]


@pytest.mark.parametrize("tail", [b"\x00" * 1521, module.HEAD.pack(5, zlib.crc32(b"block")) + b"block"], ids=["zeros", "no block"])
def test_what_is_no_block_costs_nothing_else(tmp_path, tail):
    clock = FastClock()
    store = outage(tmp_path, clock, 3)
    (path,) = tmp_path.iterdir()
    with path.open("ab") as file:
        file.write(tail)
    assert [b.seq for b in after(store, clock).taken] == [0, 1, 2]
    again = Store(tmp_path, "m1", MANY, clock)
    assert [b.seq for b in after(again, clock).taken] == [0, 1, 2]
    again.close()


def test_nothing_is_appended_behind_a_record_that_was_cut(tmp_path):
    """A process that is killed in the middle of a write leaves half a record; what its next start keeps goes to another file."""
    clock = FastClock()
    outage(tmp_path, clock, 3)
    (path,) = tmp_path.iterdir()
    os.truncate(path, path.stat().st_size - 500)
    second = Store(tmp_path, "m1", MANY, clock)
    second.encode(block(0, "s2"))
    second.close()
    assert [(b.session, b.seq) for b in after(Store(tmp_path, "m1", MANY, clock), clock).taken] == [("s1", 0), ("s1", 1)]
    assert [(b.session, b.seq) for b in after(Store(tmp_path, "m1", MANY, clock), clock, ("s1", 0, 200)).taken] == [("s2", 0)]


def test_nothing_is_appended_behind_a_write_that_failed(tmp_path, monkeypatch):
    clock = FastClock()
    store = outage(tmp_path, clock, 2)
    (path,) = tmp_path.iterdir()

    class Full(io.BytesIO):
        def write(self, data):
            with open(path, "ab") as file:
                file.write(data[:700])
            raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", lambda *_: Full())
        store.encode(block(2))
        passing(clock, SPILL_SECONDS + 1)
        patch.setattr(store, "_sync", lambda path: None)
        store.tick(pytest.fail)
    assert store.statement() == {"s1": [(200, 300)]}
    store.encode(block(3))
    store.close()
    assert [b.seq for b in after(Store(tmp_path, "m1", MANY, clock), clock).taken] == [0, 1]
    assert [b.seq for b in after(Store(tmp_path, "m1", MANY, clock), clock, ("s1", 0, 200)).taken] == [3]


def test_every_bit_of_a_record_counts(tmp_path):
    clock = FastClock()
    outage(tmp_path, clock, 2)
    (path,) = tmp_path.iterdir()
    data = path.read_bytes()
    first = module.HEAD.size + module.HEAD.unpack(data[: module.HEAD.size])[0]
    for at in [*range(4), *range(4, len(data), 97)]:
        path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        assert [b.seq for b in after(Store(tmp_path, "m1", MANY, clock), clock).taken] == ([] if at < 4 else [1] if at < first else [0])


def test_a_record_that_the_disk_damages_is_stated_and_holds_up_nothing(tmp_path):
    clock = FastClock()
    store = outage(tmp_path, clock, 3)
    (path,) = tmp_path.iterdir()
    data = bytearray(path.read_bytes())
    data[100] ^= 1
    path.write_bytes(data)
    assert [b.seq for b in after(store, clock).taken] == [1, 2]
    assert store.statement() == {"s1": [(0, 100)]}
    after(store, clock, ("s1", 100, 300))
    assert not list(tmp_path.iterdir())


def test_a_full_store_keeps_the_newest_and_states_what_it_lost(tmp_path, monkeypatch):
    size = len(codec.encode_block(block(0))) + module.HEAD.size
    monkeypatch.setattr(module, "SEGMENT_BYTES", 2.5 * size)
    clock = FastClock()
    store = outage(tmp_path, clock, 20, most=6.2 * size)
    assert store.waiting <= 6.2 * size
    assert store.statement() == {"s1": [(0, 1400)]}
    assert store.statement() == {}
    taken = [b.seq for _ in range(4) for b in after(store, clock, ("s1", 0, 0)).taken]
    assert sorted(set(taken)) == list(range(14, 20))


def test_a_disk_that_takes_nothing_is_stated_and_reported_once(tmp_path, caplog):
    (tmp_path / "store").write_text("a file where the folder should be")
    clock = FastClock()
    store = Store(tmp_path / "store", "m1", MANY, clock)
    store.encode(block(3))
    passing(clock, SPILL_SECONDS + 1)
    store.tick(pytest.fail)
    store.tick(pytest.fail)
    assert store.statement() == {"s1": [(300, 400)]}
    assert [r.getMessage() for r in caplog.records] == [f"{tmp_path / 'store'}: blocks cannot be kept: File exists"]


def test_a_disk_that_hangs_costs_the_oldest_blocks_and_no_more_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "MOST_FRESH", 10)
    store = Store(tmp_path, "m1", MANY, FastClock())
    for seq in range(15):
        store.encode(block(seq))
    assert store.statement() == {"s1": [(0, 500)]}
