"""What people may ask of a running service, and the answers as JSON values."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.wire import codec
from afdsvc.wire.messages import Command, CommandReply

Handler = Callable[[Mapping[str, Any], str], Any]


def answer(handlers: Mapping[str, Handler], payload: bytes) -> bytes:
    """Return the encoded reply; every failure becomes one sentence."""
    try:
        command = codec.decode_command(payload)
        handler = handlers.get(command.name)
        if handler is None:
            raise BadInput(f"unknown command '{command.name}'; known are {', '.join(sorted(handlers))}")
        reply = CommandReply(True, plain(handler(command.arguments, command.asked_by)))
    except AfdsvcError as error:
        reply = CommandReply(False, error=str(error))
    except Exception as error:
        reply = CommandReply(False, error=f"{type(error).__name__}: {error}")
    return codec.encode_command_reply(reply)


def ask(send: Callable[[bytes], bytes], name: str, asked_by: str, **arguments: Any) -> Any:
    """Send a command with ``send`` and return its result; raises `AfdsvcError` with the service's sentence."""
    reply = codec.decode_command_reply(send(codec.encode_command(Command(name, arguments, asked_by))))
    if not reply.ok:
        raise AfdsvcError(reply.error)
    return reply.result


def plain(value: Any) -> Any:
    """Return dataclasses, mappings and sequences as JSON values; a number that is not finite becomes None."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return value
