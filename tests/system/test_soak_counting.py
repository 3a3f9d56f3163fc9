"""What a soak counts as false alarms, and what it holds them against."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from afdsvc.api.signals import Block, Channel
from afdsvc.diagnosis.alarm_book import raised
from afdsvc.service.notifications import History, Judged
from afdsvc.wire.messages import AlarmChange, AlarmKind, EventKind, RigEvent
from benchmarks.soak import counting
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


def test_samples_that_a_rig_says_its_store_could_not_keep_explain_their_gap_and_no_other(tmp_path, monkeypatch):
    event = RigEvent("m1", "s", 0, EventKind.NOTE, cause="samples 10 to 19, 35 to 37 of session s could not be kept: the store was full or failed")
    kept = [Block("m1", "s", 0, k, 0.1, int(1e8 * k), (Channel("y_a"),), np.zeros((n, 1))) for k, n in ((0, 10), (20, 15), (40, 5))]
    monkeypatch.setattr(counting, "Recording", lambda path: SimpleNamespace(events=lambda: [event], blocks=lambda: kept))
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings" / "m1-20261127.mcap").touch()
    testbed = SimpleNamespace(folder=tmp_path, ids=["m1"], true_time=lambda t: t + 1)
    samples, accounted, missing, unexplained = counting.count_samples(testbed, [])
    assert (samples, accounted.total(), missing.total()) == (30, 1, 10)
    assert unexplained == ["m1: 5 samples missing from 00:00:04, unexplained"]
