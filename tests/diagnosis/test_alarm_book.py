"""What may happen to an alarm and what may not; the words are those of OPC UA Part 9."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from afdsvc.api.evidence import Evidence, Severity
from afdsvc.diagnosis.alarm_book import AlarmBook, Policy
from afdsvc.errors import BadInput, Refused
from afdsvc.wire.messages import AlarmKind, Finding

SECOND = 1_000_000_000


def said(fault: str | None = "a", t: int = 0, detected: bool = True, detector: str = "regression", trust: bool = True) -> Finding:
    severity = Severity(-0.5, 0.1) if fault else None
    evidence = Evidence(detector, "m", 0, float(t), 9.0, 4.0, detected, "b", fault=fault, severity=severity, trustworthy=trust)
    return Finding(evidence, "s", t * SECOND)


def book(**policy) -> tuple[AlarmBook, list[tuple[str, str]]]:
    reported: list[tuple[str, str]] = []
    return AlarmBook(Policy(**policy), lambda change: reported.append((change.alarm.id, change.event))), reported


def test_a_decision_raises_an_alarm_once_and_later_ones_support_it():
    b, reported = book()
    assert b.take(said(t=1)).count == 1
    assert b.take(said(t=2)).count == 2
    assert b.take(said(t=3, detector="cusum")).raised_by == ("regression", "cusum")
    assert reported == [("m/a", "raised"), ("m/a", "supported")]
    alarm = b.alarms["m/a"]
    assert (alarm.since_ns, alarm.last_ns, alarm.active, alarm.kind) == (SECOND, 3 * SECOND, True, AlarmKind.FAULT)


def test_an_alarm_says_what_the_last_decision_says():
    b, _ = book()
    b.take(said(t=1), "a -11 %")
    b.take(said(t=2), "a -30 %")
    assert b.alarms["m/a"].sentence == "a -30 %"


def test_what_is_not_trustworthy_neither_raises_nor_ends():
    b, reported = book()
    assert b.take(said(trust=False)) is None
    b.take(said())
    for t in range(5):
        b.take(said(t=t, detected=False, fault=None, trust=False))
    assert b.alarms["m/a"].active
    assert reported == [("m/a", "raised")]


def test_debounce_asks_for_decisions_in_a_row():
    b, reported = book(raise_after=3)
    for detected in (True, True, False, True, True):
        assert b.take(said(detected=detected, fault="a" if detected else None)) is None
    assert b.take(said()) is not None
    assert reported == [("m/a", "raised")]


def test_hysteresis_asks_every_detector_that_raised_it():
    b, reported = book(clear_after=2)
    b.take(said(detector="x"))
    b.take(said(detector="y"))
    for detector in ("x", "x", "y"):
        b.take(said(detected=False, fault=None, detector=detector))
    b.take(said(detector="y"))
    b.take(said(detected=False, fault=None, detector="y"))
    assert b.alarms["m/a"].active
    b.take(said(detected=False, fault=None, detector="y", t=9))
    assert not b.alarms["m/a"].active
    assert b.alarms["m/a"].ended_ns == 9 * SECOND
    assert reported[-1] == ("m/a", "ended")


def test_a_detector_that_now_names_another_fault_speaks_against_the_first():
    b, _ = book(clear_after=1)
    b.take(said(fault=None))
    b.take(said(fault="a"))
    assert not b.alarms["m/unnamed"].active
    assert b.alarms["m/a"].active


def test_an_alarm_that_comes_again_must_be_seen_again():
    b, _ = book(clear_after=1)
    first = b.take(said(t=1))
    b.acknowledge("m/a", "kim", "seen", 2)
    b.confirm("m/a", "kim", "bearing cleaned", 3)
    b.take(said(detected=False, fault=None, t=4))
    again = b.take(said(t=5))
    assert not again.acknowledged
    assert not again.confirmed
    assert again.since_ns != first.since_ns
    with pytest.raises(Refused, match="occurred again since"):
        b.acknowledge("m/a", "kim", "", 6, seen_ns=first.since_ns)
    assert b.acknowledge("m/a", "kim", "", 6, seen_ns=again.since_ns).acknowledged


def test_confirming_comes_after_acknowledging():
    b, _ = book()
    b.take(said())
    with pytest.raises(Refused, match="not acknowledged"):
        b.confirm("m/a", "kim", "", 1)


def test_a_latched_alarm_stays_until_somebody_who_saw_it_resets_it():
    b, _ = book(clear_after=1, latch=True)
    b.take(said())
    with pytest.raises(Refused, match="still holds"):
        b.reset("m/a", "kim", "", 1)
    b.take(said(detected=False, fault=None))
    assert b.alarms["m/a"].latched
    with pytest.raises(Refused, match="not acknowledged"):
        b.reset("m/a", "kim", "", 1)
    b.acknowledge("m/a", "kim", "", 1)
    assert b.of("m")
    b.reset("m/a", "kim", "", 2)
    assert b.of("m") == ()


def test_a_shelved_alarm_is_not_announced_until_its_time_is_over():
    b, reported = book()
    b.take(said())
    b.shelve("m/a", "kim", 10, "sensor is being changed", 0)
    assert not b.alarms["m/a"].announced
    b.tick(599 * SECOND)
    assert b.alarms["m/a"].shelved_by == "kim"
    b.tick(600 * SECOND)
    assert b.alarms["m/a"].announced
    assert reported[-1] == ("m/a", "unshelved")
    with pytest.raises(BadInput, match="without a reason"):
        b.shelve("m/a", "kim", 10, " ", 0)
    for minutes in (0, -1, 1e9, float("nan")):
        with pytest.raises(BadInput, match="more than 0 and at most 1440"):
            b.shelve("m/a", "kim", minutes, "x", 0)


def test_a_shelved_alarm_that_ends_and_returns_stays_on_the_shelf():
    b, _ = book(clear_after=1)
    b.take(said())
    b.shelve("m/a", "kim", 10, "x", 0)
    b.take(said(detected=False, fault=None))
    assert b.take(said()).shelved_by == "kim"


def test_consequences_are_grouped_under_their_cause():
    b, _ = book()
    b.take(said(fault="a", detector="x"))
    b.take(said(fault="b", detector="y"))
    b.group("m", "b", 1)
    assert (b.alarms["m/a"].cause, b.alarms["m/b"].cause) == ("m/b", "")
    assert not b.alarms["m/a"].announced
    b.group("m", None, 1)
    assert b.alarms["m/a"].cause == "m/b"
    b.condition("m", "frozen_sensor", AlarmKind.SYSTEM, True, "output 1 stands still", 2)
    b.group("m", "b", 2)
    assert b.alarms["m/b"].cause == "m/frozen_sensor"
    b.condition("m", "frozen_sensor", AlarmKind.SYSTEM, False, "moves again", 3)
    b.group("m", None, 3)
    assert b.alarms["m/a"].announced
    assert b.alarms["m/b"].announced


def test_a_notice_needs_nobody_and_ends_by_itself():
    b, reported = book()
    for holds in (True, True, False, False):
        b.condition("m", "model_gap", AlarmKind.NOTICE, holds, "why", 1)
    assert reported == [("m/model_gap", "raised"), ("m/model_gap", "ended")]
    assert b.of("m") == ()


def test_an_unknown_id_is_named():
    b, _ = book()
    b.take(said())
    with pytest.raises(BadInput, match="no alarm 'm/z'; there are m/a"):
        b.acknowledge("m/z", "kim")


DECISIONS = st.lists(st.tuples(st.sampled_from("ab"), st.booleans(), st.sampled_from(["x", "y"]), st.booleans()), max_size=40)


@given(decisions=DECISIONS, up=st.integers(1, 4), down=st.integers(1, 4))
def test_raised_and_ended_alternate_whatever_is_decided(decisions, up, down):
    b, reported = book(raise_after=up, clear_after=down)
    for t, (fault, detected, detector, trust) in enumerate(decisions):
        b.take(said(fault if detected else None, t, detected, detector, trust))
    for id in b.alarms:
        events = [e for i, e in reported if i == id and e in ("raised", "ended")]
        assert events == (["raised", "ended"] * len(events))[: len(events)]
        assert b.alarms[id].active == (events[-1] == "raised")
        assert bool(b.alarms[id].raised_by) == b.alarms[id].active
