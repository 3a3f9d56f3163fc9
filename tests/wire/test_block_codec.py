"""Blocks on the wire: the bytes protobuf writes, doubles bit for bit, and one clear error for anything else."""


import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from afdsvc.api.signals import Block, Channel
from afdsvc.errors import BadInput
from afdsvc.wire import afdsvc_pb2 as pb
from afdsvc.wire.codec import decode_block, encode_block

CHANNELS = (Channel("u_voltage", "V"), Channel("y_gap", "um"), Channel("beta_gap", "um"))


def block(values=None, **changes):
    values = np.arange(12.0).reshape(4, 3) if values is None else values
    fields = {"machine": "m1", "session": "s1", "seq": 7, "k0": 1750, "dt": 2e-4, "t0_ns": 1_763_000_000_123_456_789}
    return Block(**(fields | {"channels": CHANNELS, "values": values, "burst": "b1", "late": 2, "tuning": "q1"} | changes))


def by_protobuf(b: Block) -> pb.Block:
    message = pb.Block(
        machine=b.machine,
        session=b.session,
        seq=b.seq,
        k0=b.k0,
        dt=b.dt,
        burst=b.burst,
        late=b.late,
        tuning=b.tuning,
        signals=[
            pb.Signal(name=c.name, unit=c.unit, values=v.tolist()) for c, v in zip(b.channels, b.values.T, strict=True)
        ],
    )
    message.timestamp.seconds, message.timestamp.nanos = divmod(b.t0_ns, 10**9)
    return message


blocks = st.builds(
    lambda bits, shape, seq, k0, late, unit, burst: block(
        np.resize(np.array(bits, dtype=np.uint64).view(np.float64), shape),
        channels=tuple(Channel(f"y_{i}", unit) for i in range(shape[1])),
        seq=seq,
        k0=k0,
        late=late,
        burst=burst,
    ),
    st.lists(st.integers(0, 2**64 - 1), min_size=1, max_size=40),
    st.tuples(st.integers(1, 300), st.integers(1, 5)),
    st.integers(0, 2**63 - 1),
    st.integers(0, 2**63 - 1),
    st.integers(0, 10**6),
    st.text(st.characters(exclude_categories=["Cs"]), max_size=4),
    st.text(st.characters(exclude_categories=["Cs"])),
)


@settings(deadline=None)
@given(blocks)
def test_bytes_are_the_ones_protobuf_writes_and_come_back_bit_for_bit(b):
    data = encode_block(b)
    assert data == by_protobuf(b).SerializeToString(deterministic=True)
    back = decode_block(data)
    # NaN payloads and the sign of zero count as data: bits are compared, not values.
    assert back.values.tobytes() == np.ascontiguousarray(b.values).tobytes()
    assert back.values.shape == b.values.shape
    assert back.values.flags.c_contiguous
    for name in ("machine", "session", "seq", "k0", "dt", "t0_ns", "channels", "burst", "late", "tuning"):
        assert getattr(back, name) == getattr(b, name)


def test_layout_of_values_does_not_matter():
    values = np.asfortranarray(np.random.default_rng(1).normal(size=(50, 3)))
    strided = np.random.default_rng(1).normal(size=(100, 6))[::2, ::2]
    assert np.array_equal(decode_block(encode_block(block(values))).values, values)
    assert np.array_equal(decode_block(encode_block(block(strided))).values, strided)


def damaged(change) -> bytes:
    message = by_protobuf(block())
    change(message)
    return message.SerializeToString()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: m.ClearField("machine"), ["without machine"]),
        (lambda m: m.ClearField("session"), ["without session", "'m1'"]),
        (lambda m: m.ClearField("timestamp"), ["without timestamp", "'m1'"]),
        (lambda m: m.ClearField("signals"), ["without signals", "'m1'"]),
        (lambda m: m.ClearField("dt"), ["dt = 0.0", "'m1'"]),
        (lambda m: setattr(m, "dt", float("nan")), ["dt = nan", "'m1'"]),
        (lambda m: setattr(m, "dt", float("inf")), ["dt = inf"]),
        (lambda m: setattr(m, "machine", "a/b"), ["'a/b'", "'/'"]),
        (lambda m: setattr(m, "machine", "service"), ["'service'"]),
        (lambda m: setattr(m, "seq", 2**63), ["seq = 9223372036854775808", "'m1'"]),
        (lambda m: setattr(m, "k0", 2**64 - 1), ["k0"]),
        (lambda m: setattr(m.timestamp, "nanos", -1), ["time stamp"]),
        (lambda m: setattr(m.timestamp, "seconds", -1), ["time stamp"]),
        (lambda m: setattr(m.timestamp, "seconds", 2**62), ["time stamp"]),
        (
            lambda m: m.signals[1].values.append(0.0),
            ["block 7", "'m1'", "'y_gap'", "5 samples", "4, as many as 'u_voltage'"],
        ),
        (lambda m: m.signals[2].ClearField("values"), ["'beta_gap'", "0 samples"]),
        (lambda m: [s.ClearField("values") for s in m.signals], ["'u_voltage'", "at least one"]),
        (lambda m: setattr(m.signals[1], "name", "gap"), ["block 7", "'m1'", "'gap' has no role"]),
        (lambda m: setattr(m.signals[1], "name", ""), ["block 7", "'' has no role"]),
        (lambda m: setattr(m.signals[1], "name", "u_voltage"), ["'u_voltage' comes twice"]),
    ],
)
def test_what_is_wrong_is_named(change, words):
    with pytest.raises(BadInput) as error:
        decode_block(damaged(change))
    assert all(word in str(error.value) for word in words), str(error.value)


def test_nan_and_infinity_are_data():
    values = np.array([[np.nan, np.inf, -np.inf]])
    assert np.array_equal(decode_block(encode_block(block(values))).values, values, equal_nan=True)


@pytest.mark.parametrize(
    "changes",
    [
        {"values": np.zeros((0, 3))},
        {"seq": -1},
        {"k0": 2**64},
        {"t0_ns": -1},
        {"t0_ns": 2**63},
        {"late": -1},
        {"machine": "\ud800"},
        {"channels": (Channel("u_\ud800"), *CHANNELS[1:])},
    ],
)
def test_what_cannot_be_sent_is_refused(changes):
    with pytest.raises(BadInput):
        encode_block(block(**changes))


@settings(deadline=None, max_examples=400)
@given(st.binary(max_size=200))
def test_any_bytes_decode_or_raise_bad_input(data):
    try:
        decode_block(data)
    except BadInput:
        pass


@settings(deadline=None, max_examples=400)
@given(st.data())
def test_any_damage_decodes_or_raises_bad_input(data):
    raw = bytearray(encode_block(block()))
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(raw)))
    try:
        back = decode_block(bytes(raw[:cut]))
    except BadInput:
        return
    assert back.values.shape == (len(back), len(back.channels))
