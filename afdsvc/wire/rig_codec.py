"""Descriptions and events of a rig, to bytes and back."""

from __future__ import annotations

import numpy as np

from afdsvc.api.bursts import Limits
from afdsvc.api.signals import Channel
from afdsvc.errors import BadInput
from afdsvc.wire import afdsvc_pb2 as pb
from afdsvc.wire.keys import checked_machine
from afdsvc.wire.messages import EventKind, RigDescription, RigEvent
from afdsvc.wire.parsing import build_message, count, nanoseconds, parse, positive, required, stamp


def encode_event(event: RigEvent) -> bytes:
    """Return the message; raises `BadInput` for values out of range."""
    kind = pb.RigEvent.Kind.Value(event.kind.name)
    message = build_message(
        pb.RigEvent, timestamp=stamp(event.t_ns), machine=event.machine, session=event.session, kind=kind,
        burst=event.burst, cause=event.cause, k=event.k,
    )
    return message.SerializeToString()


def decode_event(data: bytes) -> RigEvent:
    """Return the event; raises `BadInput` for an unknown kind or a missing field."""
    message = parse(pb.RigEvent, data)
    required(message, "machine", "session", "timestamp")
    names = {number: name for name, number in pb.RigEvent.Kind.items()}
    name = names.get(message.kind, "")
    if name not in EventKind.__members__:
        wanted = f"expected one of {', '.join(EventKind)}"
        raise BadInput(f"event of machine '{message.machine}' has kind {message.kind}; {wanted}")
    return RigEvent(
        checked_machine(message.machine), message.session, nanoseconds(message.timestamp), EventKind[name],
        count(message, "k"), message.burst, message.cause,
    )


def encode_description(description: RigDescription) -> bytes:
    """Return the message; raises `BadInput` for values out of range."""
    d = description
    message = build_message(
        pb.RigDescription, timestamp=stamp(d.t_ns), machine=d.machine, session=d.session, dt=d.dt,
        channels=[build_message(pb.ChannelInfo, name=c.name, unit=c.unit) for c in d.channels],
        limits=_limits_message(d.limits), controller=d.controller, site=d.site, model=d.model,
        version=d.version, driver=d.driver, samples=d.samples, late=d.late, head_room=d.head_room,
    )
    return message.SerializeToString()


def decode_description(data: bytes) -> RigDescription:
    """Return the description; raises `BadInput` naming what is missing or unsound."""
    m = parse(pb.RigDescription, data)
    required(m, "machine", "session", "timestamp", "channels")
    return RigDescription(
        checked_machine(m.machine), m.session, nanoseconds(m.timestamp), positive(m, "dt"),
        tuple(Channel(c.name, c.unit) for c in m.channels), _limits(m),
        m.controller, m.site, m.model, m.version, m.driver, count(m, "samples"), count(m, "late"), m.head_room,
    )


def _limits_message(limits: Limits | None) -> pb.Limits | None:
    if limits is None:
        return None
    bounds = {"output": limits.output.tolist(), "input": limits.input.tolist(), "alpha": limits.alpha.tolist()}
    return build_message(pb.Limits, **bounds, seconds=limits.seconds)


def _limits(message: pb.RigDescription) -> Limits | None:
    if not message.HasField("limits"):
        return None
    found = message.limits
    output, input_, alpha = (np.array(x, dtype=float) for x in (found.output, found.input, found.alpha))
    if not (np.concatenate([output, input_, alpha]) >= 0).all():
        raise BadInput(f"limits of machine '{message.machine}' are negative or NaN; expected bounds of 0 or more")
    return Limits(output, input_, alpha, positive(found, "seconds"))
