"""The topics of a recording, and what kind of message each holds."""

from __future__ import annotations

BLOCK, RESIDUAL, EVENT, FINDING, REQUEST, DESCRIPTION, PREVIEW, LOG = (
    "block", "residual", "event", "evidence", "request", "description", "preview", "log",
)  # fmt: skip


def topic(machine: str, what: str) -> str:
    """Return the topic of one kind of message of one machine: ``/bearing-1/block``."""
    return f"/{machine}/{what}"


def parts(name: str) -> tuple[str, str]:
    """Return machine and kind of a topic; ("", "") when it is not one of ours."""
    pieces = name.split("/")
    return (pieces[1], pieces[2]) if len(pieces) == 3 and not pieces[0] else ("", "")
