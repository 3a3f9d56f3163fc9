"""What a soak counts as false alarms, and what it holds them against."""

from __future__ import annotations

from types import SimpleNamespace

from afdsvc.diagnosis.alarm_book import raised
from afdsvc.service.notifications import History, Judged
from afdsvc.wire.messages import AlarmChange, AlarmKind
from benchmarks.soak.counting import count_alarms


def test_false_alarms_are_held_against_the_bursts_that_were_judged_whatever_became_of_the_recordings(tmp_path):
    """No recording is left: the history says on which bursts of healthy machines there were decisions."""
    (tmp_path / "recordings").mkdir()
    history = History(tmp_path / "recordings" / "soak-alarms.sqlite")
    bursts = [Judged("m1", f"b{n}", n) for n in range(7)] + [Judged("m1", "b7", 7, "unnamed"), Judged("m2", "b1", 1, "pump")]
    alarms = [raised("m1", "unnamed", AlarmKind.FAULT, "cusum", 7), raised("m2", "pump", AlarmKind.FAULT, "regression", 1)]
    history.add(*bursts, *(AlarmChange(alarm, "raised", alarm.since_ns) for alarm in alarms))
    named, healthy, false, missed = count_alarms(SimpleNamespace(folder=tmp_path, ids=["m1", "m2"], faults={"m2": "pump"}))
    assert (named, len(healthy), sum(bool(j.fault) for j in healthy)) == (1, 8, 1)
    assert false == ["m1/unnamed: cusum"]
    assert missed == []
