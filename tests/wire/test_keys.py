"""Keys: what zenoh accepts, what belongs together, and ids that would break them."""

import inspect

import pytest
import zenoh
from hypothesis import given, settings
from hypothesis import strategies as st

from afdsvc.errors import BadInput
from afdsvc.wire.keys import Keys, checked_id, checked_machine, machine_of, session_of

METHODS = [name for name, f in inspect.getmembers(Keys, inspect.isfunction) if not name.startswith("_")]


def key(name, site="plant", machine="m1"):
    method = getattr(Keys(site), name)
    wanted = inspect.signature(method).parameters
    return method(*({"machine": machine, "session": "s1", "operator": "kim"}[p] for p in wanted))


def test_the_block_key_is_the_documented_one():
    assert Keys("plant").block("bearing-1") == "afdsvc/plant/bearing-1/block"


@pytest.mark.parametrize("name", METHODS)
def test_every_key_is_a_key_expression_with_a_reason(name):
    assert str(zenoh.KeyExpr(key(name))) == key(name)
    assert getattr(Keys, name).__doc__.strip().endswith(".")


def test_no_two_keys_are_the_same():
    found = [key(name) for name in METHODS]
    assert len(set(found)) == len(found)


@pytest.mark.parametrize(
    ("every", "one"),
    [
        ("blocks", "block"),
        ("events", "event"),
        ("descriptions", "description"),
        ("all_alive", "alive"),
        ("residuals", "residual"),
        ("evidences", "evidence"),
        ("sessions", "alive"),
    ],
)
def test_a_wildcard_takes_its_own_and_nothing_else(every, one):
    wildcard = zenoh.KeyExpr(key(every))
    taken = {name for name in METHODS if "*" not in key(name) and wildcard.intersects(zenoh.KeyExpr(key(name)))}
    assert taken == {one}


@settings(deadline=None)
@given(st.text(max_size=70))
def test_an_accepted_id_is_a_chunk_of_a_key(text):
    try:
        checked_machine(text)
    except BadInput:
        return
    expression = Keys("plant").block(text)
    assert str(zenoh.KeyExpr(expression)) == expression
    assert machine_of(expression) == text
    assert len(expression.split("/")) == 4


@pytest.mark.parametrize("text", ["bearing-1", "M_2", "kompressor.3", "lejeæøå", "0", "a" * 64])
def test_ordinary_ids_are_accepted(text):
    assert checked_machine(text) == text


@pytest.mark.parametrize(
    "text", ["", "a/b", "a*", "$a", "a#b", "a?", "@a", "a b", "a\tb", ".a", "-a", "..", "a" * 65, "a:b", "\ud800"]
)
def test_ids_that_break_keys_files_or_paths_are_refused_by_name(text):
    with pytest.raises(BadInput, match="machine id"):
        checked_machine(text)


def test_the_service_keeps_its_own_word():
    assert checked_id("site", "service") == "service"
    with pytest.raises(BadInput, match="taken by the service"):
        Keys("plant").block("service")


def test_a_bad_site_is_refused_at_once():
    with pytest.raises(BadInput, match="site id 'a/b' contains '/'"):
        Keys("a/b")


def test_received_keys_are_read_back():
    token = Keys("plant").alive("m1", "s-20261121")
    assert (machine_of(token), session_of(token)) == ("m1", "s-20261121")


@pytest.mark.parametrize("text", ["", "afdsvc/plant", "other/plant/m1/block", "afdsvc/plant/service/status"])
def test_foreign_keys_are_refused(text):
    with pytest.raises(BadInput):
        machine_of(text)
    with pytest.raises(BadInput):
        session_of(text)
