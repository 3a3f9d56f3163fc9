"""Everything read from others ends in a value or in one sentence; the long run is `benchmarks/fuzz/run.py`."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from afdsvc.errors import AfdsvcError
from afdsvc.files.model.model_file import parse_model
from afdsvc.files.site import parse_site
from afdsvc.service import operator_requests
from afdsvc.wire import codec
from afdsvc.wire.messages import Command, CommandReply
from benchmarks.support.hostile import TARGETS
from benchmarks.support.messages import EXAMPLES

COUNTS = {"wire": 3000, "burst": 60, "recording": 200, "csv": 300, "npz": 300, "parquet": 150, "mat": 300, "mat73": 100, "model": 300, "bag": 100, "db3": 100}


@pytest.mark.parametrize("name", sorted(TARGETS))
def test_mutants_are_read_or_refused(name, tmp_path):
    target, accepted = TARGETS[name](tmp_path), 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # libraries below may warn of what they refuse
        for i in range(COUNTS.get(name, 300)):
            began = time.monotonic()
            accepted += target.try_one(Random(f"{name}-ci-{i}"))
            assert time.monotonic() - began < 5.0, f"input {i}"
    assert 0 < accepted < COUNTS.get(name, 300)


def refusal(read: Callable[[], object], otherwise: str = "accepted") -> str:
    """Return the sentence something is refused with."""
    try:
        read()
    except AfdsvcError as error:
        return str(error)
    return otherwise


@settings(max_examples=400, deadline=None)
@given(decode=st.sampled_from([decode for decode, _ in EXAMPLES]), data=st.binary(max_size=300))
def test_any_bytes_are_a_message_or_bad_input(decode, data):
    assert refusal(lambda: decode(data)) != ""


TOML = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.just("tcp/0.0.0.0:1"),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)


def toml(value) -> str:
    """Return a value as TOML, or something close to it."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k!r} = {toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, str):
        return '"' + value.replace("\\", "").replace('"', "") + '"'
    return str(value).lower()


KEYS = st.sampled_from(["site", "machines", "transport", "recording", "alarms", "id", "plant", "A", "B", "C", "D", "inputs", "noise", "x"])


@settings(max_examples=300, deadline=None)
@given(st.dictionaries(KEYS, TOML, max_size=6))
def test_any_toml_is_a_file_of_ours_or_bad_input(tables):
    text = "\n".join(f"{key} = {toml(value)}" for key, value in tables.items())
    for parse in (lambda: parse_site(text, "x.toml"), lambda: parse_model(text, "x.toml")):
        assert "x.toml" in refusal(parse, "x.toml")


@settings(max_examples=200, deadline=None)
@given(arguments=st.dictionaries(st.text(max_size=8), TOML, max_size=4), name=st.sampled_from(["echo", "crash", "none"]))
def test_any_command_is_answered_with_a_reply(arguments, name):
    handlers = {"echo": lambda a, who: dict(a), "crash": lambda a, who: 1 / 0}
    try:
        payload = codec.encode(codec.decode(Command, codec.encode(operator_requests.Command(name, arguments, "kim"))))
    except AfdsvcError:
        payload = b"\xff"
    reply = codec.decode(CommandReply, operator_requests.answer(handlers, payload))
    assert reply.ok or reply.error
