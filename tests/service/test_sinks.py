"""The service's log says in one line each what happens to a machine."""

from __future__ import annotations

import logging

from afdsvc.api.evidence import Evidence, Severity
from afdsvc.service.sinks import LogSink
from afdsvc.wire.codec import Message
from afdsvc.wire.messages import Alarm, AlarmChange, EventKind, Finding, Notice, RigEvent


def evidence(burst: str, detector: str, **more: object) -> Finding:
    return Finding(Evidence(detector, "bearing", 0, 1.0, more.pop("statistic", 12.3), 40.0, more.pop("detected", False), burst=burst, **more), "s", 0)


def test_bursts_decisions_alarms_and_people(caplog):
    caplog.set_level(logging.INFO)
    sink, severity = LogSink("bearing"), Severity(-0.5, 0.01)
    sink.take(Message(RigEvent("bearing", "s", 0, EventKind.BURST_STARTED, burst="b1", cause="asked by ann"), b""))
    sink.take(Message(RigEvent("bearing", "s", 0, EventKind.BURST_ENDED, burst="b1"), b""))  # not written
    sink.take(Message(evidence("b1", "chi_square")))
    sink.take(Message(evidence("b1", "cusum")))  # the same again: not written
    sink.take(Message(evidence("b2", "chi_square", detected=True, fault="horizontal_actuator", severity=severity)))
    sink.take(Message(evidence("", "limit_check", detected=True)))  # no burst: alarms tell
    sink.take(Message(evidence("b2", "cusum", detected=True)))
    sink.take(Message(evidence("b2", "regression", detected=True, severity=severity)))
    sink.take(Message(evidence("b3", "chi_square", trustworthy=False, reason="the actuator saturated")))
    sink.take(Message(evidence("b4", "chi_square", trustworthy=False, reason="Q came", statistic=float("nan"))))
    alarm = Alarm("a1", "bearing", "horizontal_actuator", 0, 0, severity=severity)
    sink.take(Message(AlarmChange(alarm, "raised", 0)))
    sink.take(Message(AlarmChange(alarm, "acknowledged", 0, "ann", "on my way")))
    sink.take(Message(AlarmChange(alarm, "raised", 0, "", "a fault; limit_check")))
    sink.take(Message(Notice("bearing", "error", "a fault; limit_check", 0)))  # the alarm has said it
    assert [r.getMessage() for r in caplog.records] == [
        "bearing: burst started b1: asked by ann",
        "bearing: chi_square: no fault (statistic 12.3, threshold 40)",
        "bearing: chi_square: horizontal_actuator -50.0 ± 1.0 % (statistic 12.3, threshold 40)",
        "bearing: cusum: a fault, not isolated (statistic 12.3, threshold 40)",
        "bearing: regression: a fault, not isolated, -50.0 ± 1.0 % (statistic 12.3, threshold 40)",
        "bearing: chi_square: the actuator saturated (statistic 12.3, threshold 40)",
        "bearing: chi_square: Q came",
        "bearing: alarm a1 (horizontal_actuator -50.0 ± 1.0 %) raised",
        "bearing: alarm a1 (horizontal_actuator -50.0 ± 1.0 %) acknowledged by ann: on my way",
        "bearing: alarm a1 (horizontal_actuator -50.0 ± 1.0 %) raised: a fault; limit_check",
    ]
