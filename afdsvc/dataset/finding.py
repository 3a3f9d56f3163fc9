"""One finding of the check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["ok", "warning", "stop"]


@dataclass(frozen=True, slots=True)
class Finding:
    """What the check found about one ``topic``, as a sentence; "stop" forbids a conclusion, "warning" limits it."""

    kind: Kind
    topic: str
    sentence: str
