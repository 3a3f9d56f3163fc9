"""When bursts are played: jitter, rest, quiet hours, requests, events; never two at once."""

from __future__ import annotations

from datetime import datetime, time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from afdsvc.diagnosis.verdict import Question
from afdsvc.errors import Refused
from afdsvc.files.site import Bursts
from afdsvc.service.scheduler import BurstOrder, Scheduler

NOON = datetime(2026, 11, 21, 12, 0)


def scheduler(**settings) -> Scheduler:
    return Scheduler(Bursts(**settings), np.random.default_rng(0), 0.0)


def played(s: Scheduler, seconds: float, length: float = 2.5, step: float = 0.05) -> list[tuple[float, str]]:
    """Return (time, reason) of the bursts played when each lasts ``length``."""
    out, busy_until, now = [], None, 0.0
    while now < seconds:
        if busy_until is not None and now >= busy_until:
            s.ended(now)
            busy_until = None
        wanted = s.due(now, NOON)
        if wanted:
            out.append((now, wanted.reason))
            s.started()
            busy_until = now + length
        now += step
    return out


@given(every=st.floats(1, 20), jitter=st.floats(0, 2), rest=st.floats(0, 5), seed=st.integers(0, 99))
def test_bursts_never_overlap_and_always_rest(every, jitter, rest, seed):
    s = Scheduler(Bursts(every_seconds=every, jitter_seconds=jitter, rest_seconds=rest), np.random.default_rng(seed), 0.0)
    starts = [t for t, _ in played(s, 60, step=0.1)]
    assert len(starts) >= 2
    assert min(np.diff(starts)) >= 2.5 + rest - 0.2


def test_jitter_spreads_the_period_and_keeps_its_mean():
    starts = [t for t, _ in played(scheduler(every_seconds=10.0, jitter_seconds=2.0), 2000)]
    gaps = np.diff(starts)
    assert 8 - 0.1 <= gaps.min() < 8.6
    assert 11.4 < gaps.max() <= 12.1
    assert abs(gaps.mean() - 10) < 0.35


def test_without_a_period_nothing_is_played():
    assert played(scheduler(), 100) == []


def test_quiet_hours_span_midnight():
    s = scheduler(every_seconds=1.0, quiet_hours=[(time(22), time(6)), (time(12, 30), time(13))])
    for hour, minute, quiet in [
        (21, 59, False),
        (22, 0, True),
        (3, 0, True),
        (6, 0, False),
        (12, 45, True),
        (13, 0, False),
    ]:
        assert s.quiet(datetime(2026, 11, 21, hour, minute)) is quiet
    assert s.due(100.0, datetime(2026, 11, 21, 23)) is None
    with pytest.raises(Refused, match="quiet hours"):
        s.request(BurstOrder("person"), 100.0, datetime(2026, 11, 21, 23))


def test_requests_are_refused_with_their_reason():
    s = scheduler(rest_seconds=5.0)
    s.request(BurstOrder("asked by Ada"), 0.0, NOON)
    assert s.due(0.0, NOON) == BurstOrder("asked by Ada")
    s.started()
    with pytest.raises(Refused, match="only one burst"):
        s.request(BurstOrder("again"), 1.0, NOON)
    s.ended(3.0)
    with pytest.raises(Refused, match=r"lasts another 4\.0 s"):
        s.request(BurstOrder("again"), 4.0, NOON)
    s.paused = "by Ada: maintenance"
    with pytest.raises(Refused, match="paused: by Ada"):
        s.request(BurstOrder("again"), 20.0, NOON)


def test_an_event_asks_for_one_burst_only_where_the_site_wants_it():
    s = scheduler(after_event=True)
    s.after_event("bearing/unnamed")
    s.after_event("bearing/unnamed")
    assert [r for _, r in played(s, 20)] == ["after event: bearing/unnamed"]
    quiet = scheduler()
    quiet.after_event("x")
    assert played(quiet, 20) == []


def test_a_machine_that_restarts_is_excited_by_its_new_clock():
    s = scheduler(every_seconds=5.0, first_after_seconds=2.0, rest_seconds=1.0)
    assert s.due(369.0, NOON) is not None
    s.started()
    s.ended(369.0)
    s.machine_appeared(0.0)
    assert s.due(2.0, NOON) == BurstOrder("periodic", at=2.0)


def test_an_open_question_gets_one_second_burst_unless_it_is_settled_first():
    s = scheduler(rest_seconds=1.0)
    question = Question("b1", {"actuator": 0.6, "sensor": 0.4, "other": 0.0}, -0.2)
    s.follow_up(question)
    s.follow_up(question)
    wanted = s.due(0.0, NOON)
    assert wanted is not None
    assert (wanted.purpose, wanted.question) == ("isolate", question)
    assert wanted.reason == "burst b1 does not decide whether it is actuator or sensor"
    assert s.due(0.0, NOON) is None
    s.follow_up(question)
    assert s.due(0.0, NOON) is None  # one burst is followed by one, however often its decisions leave the question open
    s.follow_up(Question("b2", {"actuator": 0.6, "sensor": 0.4}, -0.2))
    s.settle("b2")
    assert s.due(0.0, NOON) is None
    off = scheduler(isolate=False)
    off.follow_up(question)
    assert off.due(0.0, NOON) is None
