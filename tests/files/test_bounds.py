"""Files that expand, hold more columns than any machine has, or point elsewhere are refused before they cost memory or time."""

from __future__ import annotations

import struct
import threading
import time
import tracemalloc
import zipfile
import zlib
from dataclasses import replace

import h5py
import lz4.frame
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
import zstandard
from mcap.records import Chunk
from mcap.writer import CompressionType, Writer

from afdsvc.errors import BadInput
from afdsvc.files import validation
from afdsvc.files.model.model_file import read_model
from afdsvc.files.open import Naming, open_file
from afdsvc.files.recording.mcap_records import Loss, read_items
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import read_site
from afdsvc.files.tables import foreign_mcap
from afdsvc.files.tables.foreign_mcap import read_topics
from afdsvc.files.tables.formats import read_columns
from afdsvc.files.tables.mapping import Time
from afdsvc.files.tables.mat5 import read_mat5
from afdsvc.files.validation import BOUNDS, table_bytes
from benchmarks.support.hostile import _ulog

MEGABYTE = 1_000_000


def refusal(path) -> str:
    """Return the sentence a table is refused with, read with little memory."""
    tracemalloc.start()
    try:
        with pytest.raises(BadInput) as caught:
            read_columns(path)
        assert tracemalloc.get_traced_memory()[1] < 100 * MEGABYTE
    finally:
        tracemalloc.stop()
    return str(caught.value)


def csv_of_columns(path):
    path.write_text(",".join(f"u_{i}" for i in range(10**5)) + "\n" + ",".join(["1"] * 10**5) + "\n")


def csv_of_one_line(path):
    path.write_text("t," * 10**6)


def parquet_of_zeros(path):
    pq.write_table(pa.table({"y_a": pa.array(np.zeros(40 * MEGABYTE))}), path)


def parquet_of_columns(path):
    pq.write_table(pa.table({f"u_{i}": [1.0] for i in range(5000)}), path)


def npz_of_zeros(path):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("y_a.npy", "w", force_zip64=True) as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (40 * MEGABYTE,)})
        for _ in range(320):
            file.write(bytes(MEGABYTE))


def npz_of_columns(path):
    np.savez(path, **{f"u_{i}": np.ones(1) for i in range(5000)})


def hdf5_of_zeros(path):
    with h5py.File(path, "w") as file:
        file.create_dataset("y_a", (10**9,), "f8", chunks=(10**6,), compression="gzip")


SENTENCES = {
    csv_of_columns: ("a.csv", "100,000 columns; at most 4,096"),
    csv_of_one_line: ("b.csv", "characters in its first line"),
    parquet_of_zeros: ("a.parquet", "320,000,000 bytes of numbers; at most 256,000,000"),
    parquet_of_columns: ("b.parquet", "5,000 columns"),
    npz_of_zeros: ("a.npz", "bytes of numbers; at most 256,000,000"),
    npz_of_columns: ("b.npz", "5,000 columns"),
    hdf5_of_zeros: ("a.mat", "8,000,000,000 bytes of numbers"),
}


@pytest.mark.parametrize("write", SENTENCES)
def test_a_table_that_expands_or_has_too_many_columns_is_refused(tmp_path, write):
    name, sentence = SENTENCES[write]
    write(tmp_path / name)
    assert sentence in refusal(tmp_path / name)


def test_a_mat_file_expands_no_further_than_its_bound(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"y_a": np.zeros(10**6)}, do_compression=True)
    data = (tmp_path / "a.mat").read_bytes()
    assert read_mat5(data)["y_a"].size == 10**6
    with pytest.raises(ValueError, match="expand to more bytes than are read"):
        read_mat5(data, 10**6)


@pytest.mark.parametrize("kind", ["external link", "soft link", "external storage", "virtual"])
def test_numbers_that_lie_in_another_file_are_not_fetched(tmp_path, kind):
    secret = tmp_path / "secret.h5"
    with h5py.File(secret, "w") as file:
        file["key"] = np.arange(5.0)
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file["t"] = np.arange(5.0)
        if kind == "external link":
            file["u_key"] = h5py.ExternalLink(str(secret), "/key")
        elif kind == "soft link":
            file["u_key"] = h5py.SoftLink("/t")
        elif kind == "external storage":
            file.create_dataset("u_key", (5,), "f8", external=[(str(secret), 0, 40)])
        else:
            layout = h5py.VirtualLayout((5,), "f8")
            layout[:] = h5py.VirtualSource(str(secret), "key", (5,))
            file.create_virtual_dataset("u_key", layout)
    with pytest.raises(BadInput, match=r"variable 'u_key' (is a link to another place|keeps its numbers in another file)"):
        read_columns(tmp_path / "a.mat")


def bomb(path, compress, compression: str, chunks: int, size: int, stated: int | None = None, record: bytes = b"\0") -> None:
    """Write a recording of chunks that expand to ``size`` bytes of one record again and again, and state ``stated``."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start()
        writer.finish()
    whole = path.read_bytes()
    head = whole[: whole.index(b"\x0f", 17)]  # up to the end of the data section
    data, built = compress(record * (size // len(record))), bytearray(head)
    chunk = Chunk(
        compression=compression, data=data, message_start_time=0, message_end_time=0, uncompressed_crc=0,
        uncompressed_size=size if stated is None else stated,
    )
    body = b"".join([
        (0).to_bytes(16, "little"), chunk.uncompressed_size.to_bytes(8, "little"), bytes(4), len(compression).to_bytes(4, "little"),
        compression.encode(), len(data).to_bytes(8, "little"), data,
    ])  # fmt: skip
    built += chunks * (b"\x06" + len(body).to_bytes(8, "little") + body)
    path.write_bytes(bytes(built) + whole[len(head) :])


COMPRESSED = {"zstd": zstandard.ZstdCompressor(level=3).compress, "lz4": lz4.frame.compress}


@pytest.mark.parametrize("compression", COMPRESSED)
def test_a_recording_whose_chunks_expand_is_refused_before_any_is_read(tmp_path, compression):
    path = tmp_path / "a.mcap"
    bomb(path, COMPRESSED[compression], compression, 40, 32 * MEGABYTE)
    with pytest.raises(BadInput, match=r"holds 1,280,000,000 bytes in its chunks; at most 1,0\d\d,\d{3},\d{3} are read"):
        Recording(path)


@pytest.mark.parametrize("compression", COMPRESSED)
@pytest.mark.parametrize("stated", [10, 300 * MEGABYTE])
def test_a_chunk_that_holds_more_than_it_states_costs_only_what_it_states(tmp_path, compression, stated):
    path = tmp_path / "a.mcap"
    bomb(path, COMPRESSED[compression], compression, 1, 64 * MEGABYTE, stated)
    tracemalloc.start()
    losses = [item.sentence for item in read_items(path) if isinstance(item, Loss)]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(losses) == 1
    assert ("more bytes than the 10 it states" if stated == 10 else "it states 300,000,000 bytes; at most 256,000,000") in losses[0]
    assert peak < 20 * MEGABYTE


def test_a_chunk_of_zeros_ends_at_its_first_record(tmp_path):
    path = tmp_path / "a.mcap"
    bomb(path, zlib.compress, "", 0, 1)
    bomb(path, COMPRESSED["zstd"], "zstd", 1, MEGABYTE)
    assert "a record of kind 0" in Recording(path).loss


def test_mapped_topics_of_others_are_kept_up_to_a_bound(tmp_path, monkeypatch):
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("/force", "json", writer.register_schema("force", "jsonschema", b"{}"))
        for k in range(200):
            writer.add_message(channel, k * 10**7, b'{"value": 1.0, "more": "%s"}' % (b"x" * 10_000), k * 10**7)
        writer.finish()
    read_topics(path, read_items(path), {"u_force": "/force.value"}, Time())
    monkeypatch.setattr(foreign_mcap, "table_bytes", lambda size: MEGABYTE)
    with pytest.raises(BadInput, match=r"bytes in mapped messages; at most 1,000,000"):
        read_topics(path, read_items(path), {"u_force": "/force.value"}, Time())


def test_a_text_of_any_length_is_not_read(tmp_path):
    path = tmp_path / "site.toml"
    path.write_text("#" * (BOUNDS.text + 1))
    with pytest.raises(BadInput, match=r"holds 16,000,001 bytes; at most 16,000,000"):
        read_site(path)


def test_what_a_table_may_hold_grows_with_its_file():
    assert [table_bytes(size) for size in (0, 10 * MEGABYTE, 10**9)] == [BOUNDS.table_free, 10**9, BOUNDS.table]


@pytest.mark.parametrize("log", ["nested", "many", "itself"])
def test_fields_of_a_ulog_that_grow_from_a_few_bytes_are_refused(tmp_path, log):
    """Arrays in arrays, many topics of one long array, and a format that holds itself."""
    pytest.importorskip("pyulog")
    array = _ulog(b"F", b"a:uint8_t[65535] x;")
    said = {
        "nested": array + _ulog(b"F", b"b:a[65535] y;") + _ulog(b"F", b"c:b[65535] z;") + _ulog(b"A", b"\0\0\0c"),
        "many": array + b"".join(_ulog(b"A", b"\0" + struct.pack("<H", i) + b"a") for i in range(1000)),
        "itself": _ulog(b"F", b"a:a x;") + _ulog(b"A", b"\0\0\0a"),
    }[log]
    (tmp_path / "bomb.ulg").write_bytes(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + said)
    (tmp_path / "map.toml").write_text("[signals]\nu_force = 'c.x'\n")
    tracemalloc.start()
    try:
        with pytest.raises(BadInput, match=r"fields of topics; at most|not a readable ULog"):
            open_file(tmp_path / "bomb.ulg", Naming.of(tmp_path / "map.toml")).traces()
        assert tracemalloc.get_traced_memory()[1] < 100 * MEGABYTE
    finally:
        tracemalloc.stop()


@pytest.fixture
def short_of_time(monkeypatch):
    """Let a file be read for 0.3 s, and one more for each of its megabytes."""
    monkeypatch.setattr(validation, "BOUNDS", replace(BOUNDS, seconds=0.3))


@pytest.mark.usefixtures("short_of_time")
def test_a_small_text_that_takes_the_library_hours_is_given_up(tmp_path):
    path = tmp_path / "site.toml"
    path.write_text("a." * 100_000 + "a = 1\n")  # the reader of TOML looks at all beginnings of a key, each from its beginning
    with pytest.raises(BadInput, match=r"site.toml: is still being read after 0.5 s; at most that long is spent on 200,006 bytes"):
        read_site(path)
    assert ends_within(20.0)


def ends_within(seconds: float) -> bool:
    """Return whether no reader that was given up goes on computing."""
    until = time.monotonic() + seconds
    while any(t.name == "reader" for t in threading.enumerate()):
        if time.monotonic() > until:
            return False
        time.sleep(0.05)
    return True


@pytest.mark.usefixtures("short_of_time")
@pytest.mark.parametrize("read", [lambda path: list(read_items(path)), lambda path: list(Recording(path).blocks())])
def test_a_small_recording_of_ten_million_messages_is_given_up(tmp_path, read):
    path = tmp_path / "a.mcap"
    message = b"\x05" + (22).to_bytes(8, "little") + bytes(22)
    bomb(path, COMPRESSED["zstd"], "zstd", 10, 31 * MEGABYTE, record=message)
    assert path.stat().st_size < 100_000
    began = time.process_time()
    with pytest.raises(BadInput, match=r"a.mcap: is still being read after 0.3\d* s"):
        read(path)
    assert time.process_time() - began < 3.0


@pytest.mark.usefixtures("short_of_time")
def test_the_time_of_whoever_takes_the_records_does_not_count():
    def take(item):
        until = time.thread_time() + 0.1
        while time.thread_time() < until:
            pass
        return item

    assert [take(i) for i in validation.items_in_time(iter(range(8)), "a", 0)] == list(range(8))


@pytest.mark.parametrize("suffix", ["csv", "npz", "mat", "parquet", "mcap", "toml", "tdms"])
def test_what_may_never_end_is_not_begun(tmp_path, suffix):
    """A link to /dev/zero, as an archive may hold one, states no size and has no end."""
    link = tmp_path / f"a.{suffix}"
    link.symlink_to("/dev/zero")
    with pytest.raises(BadInput, match="is a device, pipe or socket"):
        (read_model if suffix == "toml" else lambda path: open_file(path, Naming()).traces())(link)
