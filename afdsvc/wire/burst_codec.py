"""Burst requests, their replies and leases, to bytes and back."""

from __future__ import annotations

import math

import numpy as np

from afdsvc.api.bursts import Burst, Line
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array
from afdsvc.wire import afdsvc_pb2 as pb
from afdsvc.wire.keys import checked_machine
from afdsvc.wire.messages import BurstReply, BurstRequest, BurstStop, Lease, Receipt
from afdsvc.wire.parsing import build_message, count, nanoseconds, parse, positive, required, stamp


def encode_burst_request(request: BurstRequest) -> bytes:
    """Return the message; raises `BadInput` for values out of range."""
    message = build_message(
        pb.BurstRequest, timestamp=stamp(request.t_ns), machine=request.machine, burst=_burst_message(request.burst),
        lease=request.lease, asked_by=request.asked_by, start=request.start, session=request.session, k=request.k,
    )
    return message.SerializeToString(deterministic=True)


def decode_burst_request(data: bytes) -> BurstRequest:
    """Return the request; raises `BadInput` naming what is missing or unsound, NaN in the burst included."""
    message = parse(pb.BurstRequest, data)
    required(message, "machine", "timestamp", "burst", "asked_by")
    return BurstRequest(
        checked_machine(message.machine), _burst(message.burst), positive(message, "lease"), message.asked_by,
        nanoseconds(message.timestamp), count(message, "start"), message.session, count(message, "k"),
    )


def encode_burst_reply(reply: BurstReply) -> bytes:
    """Return the message."""
    return build_message(pb.BurstReply, accepted=reply.accepted, burst=reply.burst, reason=reply.reason).SerializeToString()


def decode_burst_reply(data: bytes) -> BurstReply:
    """Return the reply; raises `BadInput` for a refusal without reason."""
    message = parse(pb.BurstReply, data)
    if not message.accepted:
        required(message, "reason")
    return BurstReply(message.accepted, message.burst, message.reason)


def encode_burst_stop(stop: BurstStop) -> bytes:
    """Return the message."""
    fields = {"machine": stop.machine, "burst": stop.burst, "reason": stop.reason, "asked_by": stop.asked_by}
    return build_message(pb.BurstStop, **fields).SerializeToString()


def decode_burst_stop(data: bytes) -> BurstStop:
    """Return the request to stop; raises `BadInput` when it does not say which machine, why and who asks."""
    message = parse(pb.BurstStop, data)
    required(message, "machine", "reason", "asked_by")
    return BurstStop(checked_machine(message.machine), message.reason, message.asked_by, message.burst)


def encode_lease(lease: Lease) -> bytes:
    """Return the message."""
    return build_message(pb.Lease, machine=lease.machine, burst=lease.burst, seconds=lease.seconds).SerializeToString()


def decode_lease(data: bytes) -> Lease:
    """Return the renewal; raises `BadInput` when it names no machine or burst, or no time."""
    message = parse(pb.Lease, data)
    required(message, "machine", "burst")
    return Lease(checked_machine(message.machine), message.burst, positive(message, "seconds"))


def encode_receipt(receipt: Receipt) -> bytes:
    """Return the message."""
    ranges = [build_message(pb.SampleRange, session=session, start=start, end=end) for session, start, end in receipt.ranges]
    return build_message(pb.Receipt, machine=receipt.machine, ranges=ranges).SerializeToString()


def decode_receipt(data: bytes) -> Receipt:
    """Return the receipt; raises `BadInput` when it names no machine or a range that ends before it begins."""
    message = parse(pb.Receipt, data)
    required(message, "machine")
    ranges = tuple((r.session, count(r, "start"), count(r, "end")) for r in message.ranges)
    for session, start, end in ranges:
        if end < start:
            raise BadInput(f"Receipt message with samples {start} to {end} of session '{session[:40]}'; expected an end behind the start")
    return Receipt(checked_machine(message.machine), ranges)


def _burst_message(burst: Burst) -> pb.Burst:
    waveform = [] if burst.waveform is None else [build_message(pb.Column, values=c.tolist()) for c in burst.waveform.T]
    lines = [build_message(pb.Line, input=x.input, omega=x.omega, amplitude=x.amplitude, phase=x.phase) for x in burst.lines]
    return build_message(
        pb.Burst, name=burst.name, inputs=burst.inputs, samples=burst.samples, ramp=burst.ramp, lines=lines,
        waveform=waveform, settle=burst.settle, purpose=burst.purpose, notes=dict(burst.notes),
    )


def _burst(message: pb.Burst) -> Burst:
    required(message, "name", "inputs", "samples")
    lines = tuple(Line(x.input, *_finite(message.name, x.omega, x.amplitude, x.phase)) for x in message.lines)
    return Burst(
        message.name, message.inputs, count(message, "samples"), count(message, "ramp"), lines, _waveform(message),
        count(message, "settle"), message.purpose, dict(message.notes),
    )


def _waveform(message: pb.Burst) -> Array | None:
    if not message.waveform:
        return None
    lengths = [len(column.values) for column in message.waveform]
    if lengths != [message.samples] * message.inputs:
        wanted = f"{message.inputs} of {message.samples} samples"
        raise BadInput(f"burst '{message.name}': waveform columns of {lengths} samples; expected {wanted}")
    waveform = np.array([column.values for column in message.waveform]).T.copy()
    _finite(message.name, *waveform.ravel().tolist())
    return waveform


def _finite(name: str, *values: float) -> tuple[float, ...]:
    if not all(map(math.isfinite, values)):
        raise BadInput(f"burst '{name}' contains NaN or infinity; expected finite numbers")
    return values
