"""Status, commands and alarms of the service, to bytes and back."""

from __future__ import annotations

from afdsvc.errors import BadInput
from afdsvc.wire import afdsvc_pb2 as pb
from afdsvc.wire.keys import checked_machine
from afdsvc.wire.messages import Alarm, AlarmChange, AlarmKind, Command, CommandReply, MachineStatus, ServiceStatus
from afdsvc.wire.parsing import (
    build_message,
    count,
    json_text,
    json_value,
    nanoseconds,
    parse,
    required,
    severity_message,
    severity_of,
    stamp,
)


def encode_status(status: ServiceStatus) -> bytes:
    """Return the message; raises `BadInput` for values out of range."""
    s = status
    message = build_message(
        pb.ServiceStatus, timestamp=stamp(s.t_ns), site=s.site, version=s.version, uptime=s.uptime,
        machines=[_machine_message(m) for m in s.machines], recording=s.recording, recording_bytes=s.recording_bytes,
        recording_failure=s.recording_failure, recording_dropped=s.recording_dropped, longest_waits=dict(s.longest_waits),
    )
    return message.SerializeToString()


def decode_status(data: bytes) -> ServiceStatus:
    """Return the status; raises `BadInput` naming what is missing or unsound."""
    m = parse(pb.ServiceStatus, data)
    required(m, "site", "timestamp")
    return ServiceStatus(
        m.site, m.version, nanoseconds(m.timestamp), m.uptime, tuple(_machine(x) for x in m.machines), m.recording,
        count(m, "recording_bytes"), m.recording_failure, count(m, "recording_dropped"), dict(m.longest_waits),
    )


def encode_command(command: Command) -> bytes:
    """Return the message; raises `BadInput` for arguments JSON cannot say."""
    text = json_text(f"arguments of command '{command.name}'", dict(command.arguments))
    when = stamp(command.t_ns) if command.t_ns else None
    return build_message(
        pb.Command, name=command.name, arguments=text, asked_by=command.asked_by, timestamp=when, nonce=command.nonce
    ).SerializeToString()


def decode_command(data: bytes) -> Command:
    """Return the command; raises `BadInput` when it has no name or its arguments are not a JSON object."""
    message = parse(pb.Command, data)
    required(message, "name")
    arguments = json_value(f"arguments of command '{message.name}'", message.arguments or "{}")
    if not isinstance(arguments, dict):
        raise BadInput(f"arguments of command '{message.name}' are {message.arguments[:40]}; expected a JSON object")
    t_ns = nanoseconds(message.timestamp) if message.HasField("timestamp") else 0
    return Command(message.name, arguments, message.asked_by, t_ns, message.nonce)


def encode_command_reply(reply: CommandReply) -> bytes:
    """Return the message; raises `BadInput` for a result JSON cannot say (NaN among it)."""
    return build_message(
        pb.CommandReply, ok=reply.ok, error=reply.error, result=json_text("result", reply.result)
    ).SerializeToString()


def decode_command_reply(data: bytes) -> CommandReply:
    """Return the reply; raises `BadInput` when a failure has no reason or the result is not JSON."""
    message = parse(pb.CommandReply, data)
    if not message.ok:
        required(message, "error")
    return CommandReply(message.ok, json_value("result", message.result or "null"), message.error)


def _machine_message(m: MachineStatus) -> pb.MachineStatus:
    return build_message(
        pb.MachineStatus, machine=m.machine, session=m.session, state=m.state, reason=m.reason, blocks=m.blocks,
        lost_blocks=m.lost_blocks, late=m.late, head_room=m.head_room, block_age=m.block_age, burst=m.burst,
        next_burst=m.next_burst, trustworthy=m.trustworthy, alarms=[_alarm_message(a) for a in m.alarms], tuning=m.tuning,
    )


def _machine(m: pb.MachineStatus) -> MachineStatus:
    required(m, "machine", "state")
    return MachineStatus(
        checked_machine(m.machine), m.state, m.session, m.reason, count(m, "blocks"), count(m, "lost_blocks"),
        count(m, "late"), m.head_room, m.block_age, m.burst, m.next_burst, m.trustworthy,
        tuple(_alarm(a) for a in m.alarms), m.tuning,
    )


def encode_alarm_change(change: AlarmChange) -> bytes:
    """Return the message."""
    return build_message(
        pb.AlarmChange, timestamp=stamp(change.t_ns), alarm=_alarm_message(change.alarm), event=change.event, who=change.who,
        why=change.why,
    ).SerializeToString()


def decode_alarm_change(data: bytes) -> AlarmChange:
    """Return the change; raises `BadInput` naming what is missing."""
    message = parse(pb.AlarmChange, data)
    required(message, "timestamp", "alarm", "event")
    return AlarmChange(_alarm(message.alarm), message.event, nanoseconds(message.timestamp), message.who, message.why)


def _alarm_message(a: Alarm) -> pb.Alarm:
    return build_message(
        pb.Alarm, id=a.id, machine=a.machine, fault=a.fault, severity=severity_message(a.severity),
        since=stamp(a.since_ns), last=stamp(a.last_ns), count=a.count, active=a.active, acknowledged=a.acknowledged,
        acknowledged_by=a.acknowledged_by, comment=a.comment, kind=a.kind.value, confirmed=a.confirmed,
        confirmed_by=a.confirmed_by, latched=a.latched, shelved_until=stamp(a.shelved_until_ns) if a.shelved_until_ns else None,
        shelved_by=a.shelved_by, suppressed=a.suppressed, cause=a.cause, ended=stamp(a.ended_ns) if a.ended_ns else None,
        sentence=a.sentence, raised_by=a.raised_by,
    )


def _alarm(m: pb.Alarm) -> Alarm:
    required(m, "id", "machine", "since", "last")
    return Alarm(
        m.id, checked_machine(m.machine), m.fault, nanoseconds(m.since), nanoseconds(m.last), count(m, "count"),
        m.active, severity_of(m), m.acknowledged, m.acknowledged_by, m.comment, _kind(m.kind), m.confirmed, m.confirmed_by,
        m.latched, nanoseconds(m.shelved_until) if m.HasField("shelved_until") else 0, m.shelved_by, m.suppressed, m.cause,
        nanoseconds(m.ended) if m.HasField("ended") else 0, m.sentence, tuple(m.raised_by),
    )


def _kind(value: str) -> AlarmKind:
    try:
        return AlarmKind(value or "fault")
    except ValueError:
        raise BadInput(f"an alarm of kind '{value[:40]}'; expected fault, system or notice") from None
