"""A plain value as TOML text; only what our own files need: tables of text, numbers, lists and tables on one line."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping


class Inline(dict[str, object]):
    """A table written on one line."""


def toml_text(table: Mapping[str, object]) -> str:
    """Return the text; numbers come back bit for bit, empty tables and lists of no entries are left out at the top."""
    plain = {k: v for k, v in table.items() if not _is_section(v)}
    sections = {k: v for k, v in table.items() if isinstance(v, dict) and _is_section(v) and v}
    text = _lines(plain)
    for name, section in sections.items():
        text += f"\n[{_key(name)}]\n{_lines(section)}"
    return text


def _lines(table: Mapping[str, object]) -> str:
    return "".join(f"{_key(name)} = {_value(value)}\n" for name, value in table.items())


def _is_section(value: object) -> bool:
    return isinstance(value, dict) and not isinstance(value, Inline)


def _value(value: object) -> str:
    if isinstance(value, str):
        # JSON strings are TOML strings but for the one control character JSON lets pass.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{_key(k)} = {_value(v)}' for k, v in value.items())}}}"
    return json.dumps(value)


def _number(value: float) -> str:
    """Return whole numbers without a point (a sign on zero would be lost that way) and others as Python writes them."""
    whole = value.is_integer() and abs(value) < 1e15 and str(value) != "-0.0"
    return str(int(value)) if whole else repr(value)


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _value(name)
