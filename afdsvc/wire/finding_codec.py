"""Decisions of detectors to bytes and back."""

from __future__ import annotations

from afdsvc.api.evidence import Evidence
from afdsvc.wire import afdsvc_pb2 as pb
from afdsvc.wire.keys import checked_machine
from afdsvc.wire.messages import Finding
from afdsvc.wire.parsing import (
    build_message,
    by_name,
    count,
    named_values,
    nanoseconds,
    parse,
    required,
    severity_message,
    severity_of,
    stamp,
)


def encode_finding(finding: Finding) -> bytes:
    """Return the message, numbers bit for bit; raises `BadInput` for values out of range."""
    e = finding.evidence
    message = build_message(
        pb.Evidence, timestamp=stamp(finding.t_ns), machine=e.machine, session=finding.session, detector=e.detector,
        k=e.k, seconds=e.seconds, statistic=e.statistic, threshold=e.threshold, detected=e.detected, burst=e.burst,
        output=e.output, fault=e.fault, severity=severity_message(e.severity), weights=named_values(e.weights),
        trustworthy=e.trustworthy, reason=e.reason, p_white=e.p_white, parts=named_values(e.parts),
    )
    return message.SerializeToString()


def decode_finding(data: bytes) -> Finding:
    """Return the decision; raises `BadInput` naming what is missing or unsound."""
    m = parse(pb.Evidence, data)
    required(m, "machine", "session", "timestamp", "detector")
    if not m.trustworthy:
        required(m, "reason")
    evidence = Evidence(
        detector=m.detector, machine=checked_machine(m.machine), k=count(m, "k"), seconds=m.seconds,
        statistic=m.statistic, threshold=m.threshold, detected=m.detected, burst=m.burst, output=m.output,
        fault=m.fault if m.HasField("fault") else None, severity=severity_of(m), weights=by_name(m.weights),
        trustworthy=m.trustworthy, reason=m.reason, p_white=m.p_white if m.HasField("p_white") else None,
        parts=by_name(m.parts),
    )
    return Finding(evidence, m.session, nanoseconds(m.timestamp))
