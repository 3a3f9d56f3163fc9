"""Blocks to bytes and back.

Protobuf's Python runtime takes about 0.5 us per sample to fill packed doubles, and blocks are the bulk of all traffic.
Their signals are therefore appended to a serialised header byte by byte: tag, length, raw little-endian doubles. The bytes
are the ones protobuf itself writes.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from afdsvc.api.signals import Block, Channel
from afdsvc.errors import BadInput
from afdsvc.wire import afdsvc_pb2 as pb
from afdsvc.wire.keys import checked_machine
from afdsvc.wire.parsing import build_message, count, nanoseconds, parse, positive, required, stamp

_SIGNALS, _NAME, _UNIT, _VALUES = (n << 3 | 2 for n in (10, 1, 2, 3))  # length-delimited fields of Block and Signal


def encode_block(block: Block) -> bytes:
    """Return the message, doubles bit for bit; raises `BadInput` for a block without samples or an invalid field."""
    if not len(block):
        raise BadInput(f"block {block.seq} of machine '{block.machine}' holds no samples; expected at least one")
    header = build_message(
        pb.Block, timestamp=stamp(block.t0_ns), machine=block.machine, session=block.session, seq=block.seq,
        k0=block.k0, dt=block.dt, burst=block.burst, late=block.late, tuning=block.tuning,
    )
    columns = np.ascontiguousarray(block.values.T, dtype="<f8")
    parts = [header.SerializeToString()]
    for prefix, column in zip(_prefixes(block.channels, len(block)), columns, strict=True):
        parts += (prefix, column.tobytes())
    return b"".join(parts)


def decode_block(data: bytes) -> Block:
    """Return the block, C-contiguous; raises `BadInput` naming machine, block and channel for anything unsound."""
    message = parse(pb.Block, data)
    required(message, "machine", "session", "timestamp", "signals")
    checked_machine(message.machine)
    return Block(
        machine=message.machine, session=message.session, seq=count(message, "seq"), k0=count(message, "k0"),
        dt=positive(message, "dt"), t0_ns=nanoseconds(message.timestamp), channels=_channels_of(message),
        values=_values_of(message), burst=message.burst, late=count(message, "late"), tuning=message.tuning,
    )


def _values_of(message: pb.Block) -> np.ndarray:
    samples = len(message.signals[0].values)
    values = np.empty((samples, len(message.signals)))
    for i, signal in enumerate(message.signals):
        if len(signal.values) != samples or not samples:
            found = f"channel '{signal.name}' holds {len(signal.values)} samples"
            expected = f"{samples}, as many as '{message.signals[0].name}'" if samples else "at least one"
            raise BadInput(f"block {message.seq} of machine '{message.machine}': {found}; expected {expected}")
        values[:, i] = signal.values
    return values


def _channels_of(message: pb.Block) -> tuple[Channel, ...]:
    try:
        return _channels(tuple((signal.name, signal.unit) for signal in message.signals))
    except BadInput as error:
        raise BadInput(f"block {message.seq} of machine '{message.machine}': {error}") from None


@lru_cache(maxsize=256)
def _channels(names: tuple[tuple[str, str], ...]) -> tuple[Channel, ...]:
    """Return channels as one object per set, so that comparing sets is comparing identities."""
    seen: set[str] = set()
    for name, _ in names:
        if name in seen:
            raise BadInput(f"channel '{name}' comes twice")
        seen.add(name)
    return tuple(Channel(name, unit) for name, unit in names)


@lru_cache(maxsize=256)
def _prefixes(channels: tuple[Channel, ...], samples: int) -> tuple[bytes, ...]:
    """Return, per channel, the bytes between the previous signal's values and its own."""
    return tuple(_prefix(channel, samples) for channel in channels)


def _prefix(channel: Channel, samples: int) -> bytes:
    inner = _text(_NAME, channel.name) + _text(_UNIT, channel.unit) + bytes([_VALUES]) + _varint(8 * samples)
    return bytes([_SIGNALS]) + _varint(len(inner) + 8 * samples) + inner


def _text(tag: int, text: str) -> bytes:
    try:
        raw = text.encode()
    except UnicodeEncodeError:
        raise BadInput(f"channel name or unit {text!r} is not valid UTF-8 text") from None
    return bytes([tag]) + _varint(len(raw)) + raw if raw else b""


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)
