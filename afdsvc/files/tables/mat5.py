"""Numbers out of MAT-files of level 5, read with every length checked.

The layout is the one published by The MathWorks ("MAT-File Format", Level 5). SciPy's reader trusts the lengths in the file
and can take the whole process down over a damaged one; recordings come from anywhere, so this one does not.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

_HEADER = 128
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_INT8, _MATRIX, _COMPRESSED = 1, 14, 15
_STRUCT, _CHAR = 2, 4
_NUMBERS = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
_COMPLEX = 0x0800
_OTHERS = {1: "cell", 3: "object", _CHAR: "char", 5: "sparse"}


@dataclass(frozen=True, slots=True)
class _Element:
    kind: int
    content: bytes

    def numbers(self, order: str) -> np.ndarray:
        """Return the content as stored; raises `ValueError` for what are not numbers."""
        code = _STORED.get(self.kind)
        if code is None or len(self.content) % int(code[1]):
            raise ValueError(f"an element of type {self.kind} with {len(self.content)} bytes; expected numbers")
        return np.frombuffer(self.content, order + code)


def read_mat5(data: bytes, most: int = 1 << 30) -> dict[str, Any]:
    """Return arrays by name, structs as dictionaries, in the order of the file; raises `ValueError` for anything unsound.

    Compressed variables may expand to ``most`` bytes together.
    """
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None or len(data) < _HEADER:
        raise ValueError("no MAT-file of level 5 or 7.3")
    found = {}
    for element in _elements(data[_HEADER:], order):
        if element.kind == _COMPRESSED:
            element, held = _inflated(element, order, most)
            most -= held
        if element.kind == _MATRIX:
            name, value = _matrix(element.content, order)
            if name:
                found[name] = value
    return found


def _elements(data: bytes, order: str) -> Iterator[_Element]:
    at = 0
    while at < len(data):
        if len(data) - at < 8:
            raise ValueError(f"{len(data) - at} bytes are left over; the file is truncated")
        kind, size = np.frombuffer(data, order + "u4", 2, at).tolist()
        if kind >> 16:
            kind, size, start, step = kind & 0xFFFF, kind >> 16, at + 4, 8
            if size > 4:
                raise ValueError(f"a small element of {size} bytes; at most 4 fit")
        else:
            start, step = at + 8, 8 + size + (0 if kind == _COMPRESSED else -size % 8)
        if start + size > len(data):
            raise ValueError(f"an element of {size} bytes where {len(data) - start} are left; the file is truncated")
        yield _Element(kind, data[start : start + size])
        at += step


def _inflated(element: _Element, order: str, most: int) -> tuple[_Element, int]:
    """Return a compressed variable and its size in bytes."""
    try:
        data = zlib.decompressobj().decompress(element.content, most + 1)
        if len(data) > most:
            raise ValueError("its compressed variables expand to more bytes than are read from a file of its size")
        return next(_elements(data, order)), len(data)
    except (zlib.error, StopIteration) as error:
        raise ValueError(f"a compressed variable is damaged: {error}") from None


def _matrix(content: bytes, order: str) -> tuple[str, Any]:
    parts = list(_elements(content, order))
    if len(parts) < 3:
        return "", None
    flags, shape = parts[0].numbers(order), parts[1].numbers(order)
    if not flags.size or parts[2].kind != _INT8 or shape.dtype.kind != "i" or (shape < 0).any():
        raise ValueError("a variable without class, shape or name")
    name, kind = parts[2].content.decode("ascii", "replace"), int(flags[0]) & 0xFF
    dimensions = tuple(shape.tolist())
    if kind == _STRUCT:
        return name, _struct(name, dimensions, parts[3:], order)
    if kind not in _NUMBERS:
        return name, np.zeros(1, dtype=[(_OTHERS.get(kind, f"class {kind}"), "u1")])  # refused by its type, like any other
    if int(flags[0]) & _COMPLEX:
        return name, np.zeros(1, dtype=complex)
    return name, _numbers(name, kind, dimensions, parts[3:], order)


def _numbers(name: str, kind: int, dimensions: tuple[int, ...], parts: list[_Element], order: str) -> np.ndarray:
    stored = parts[0].numbers(order) if parts else np.zeros(0)
    if stored.size != math.prod(dimensions):
        raise ValueError(f"variable '{name}' holds {stored.size} numbers; expected {' x '.join(map(str, dimensions))}")
    with np.errstate(invalid="ignore", over="ignore"):
        return stored.astype(_NUMBERS[kind]).reshape(dimensions, order="F")


def _struct(name: str, dimensions: tuple[int, ...], parts: list[_Element], order: str) -> dict[str, Any]:
    if math.prod(dimensions) != 1 or len(parts) < 2:
        raise ValueError(f"variable '{name}' is an array of {math.prod(dimensions)} structs; expected one")
    length = int(parts[0].numbers(order)[0]) if parts[0].content else 0
    text = parts[1].content
    if length < 1 or len(text) % length:
        raise ValueError(f"variable '{name}' has field names of {length} characters in {len(text)} bytes")
    names = [text[i : i + length].split(b"\0")[0].decode("ascii", "replace") for i in range(0, len(text), length)]
    values = [_matrix(part.content, order)[1] for part in parts[2:] if part.kind == _MATRIX]
    if len(values) != len(names):
        raise ValueError(f"variable '{name}' has {len(names)} fields and {len(values)} values")
    return dict(zip(names, values, strict=True))
