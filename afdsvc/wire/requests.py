"""Requests of people to the service, as a client sends them."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from typing import Any

from afdsvc.errors import AfdsvcError
from afdsvc.wire import codec
from afdsvc.wire.messages import Command, CommandReply

QUESTIONS = ("status", "alarms", "history", "ticket", "plan")  # requests that change nothing
RETUNING = ("retune", "restore")  # what those may ask who may retune


def ask(send: Callable[[bytes], bytes], name: str, asked_by: str, **arguments: Any) -> Any:
    """Send a command with ``send`` and return its result; raises `AfdsvcError` with the service's sentence."""
    command = Command(name, arguments, asked_by, time.time_ns(), secrets.token_hex(8))
    reply = codec.decode(CommandReply, send(codec.encode(command)))
    if not reply.ok:
        raise AfdsvcError(reply.error)
    return reply.result
