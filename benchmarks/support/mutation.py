"""Bytes and texts made hostile, reproducibly: the same seed gives the same mutant."""

from __future__ import annotations

import re
from random import Random

_EDGES = (b"\x00", b"\xff", b"\x7f", b"\x80", b"\xff\xff\xff\xff\x0f", b"\xff" * 9 + b"\x01", b"\x00" * 8, b"\xf0\x7f", b"\xf8\x7f")
_TOKEN = re.compile(r"[A-Za-z_]+|-?\d+(?:\.\d+)?(?:e-?\d+)?|\s+|.", re.DOTALL)
_WORDS = (
    "nan", "inf", "-inf", "0", "-1", "1e308", "1e-320", "9" * 25, "0x10", "true", '""', '"\\u0000"', "[]", "{}", "[[]]", "[[nan]]",
    "[1, [2]]", '"../../etc/passwd"', '"a" ', "'", '"', "\n", "=", "[", "]", "{", "}", "#", "\u202e", "\ud7ff", "1979-05-27",
    "[machines]", "[[machines]]", 'x = 1', '"' + "x" * 300 + '"', "[" * 60, '"tcp/0.0.0.0:1"', "07:32:00",
)  # fmt: skip


def mutate_bytes(seed: bytes, other: bytes, rng: Random) -> bytes:
    """Return the seed after one to four changes: flips, edge values, cuts, repeats, pieces of another input."""
    data = bytearray(seed)
    for _ in range(rng.randint(1, 4)):
        _change(data, other, rng)
    return bytes(data)


def _change(data: bytearray, other: bytes, rng: Random) -> None:
    at = rng.randrange(len(data) + 1)
    span = at + min(rng.choice((1, 2, 4, 8, 64)), len(data) - at)
    kind = rng.randrange(7)
    if kind == 0 and at < len(data):
        data[at] ^= 1 << rng.randrange(8)
    elif kind == 1:
        data[at:span] = rng.randbytes(span - at)
    elif kind == 2:
        edge = rng.choice(_EDGES)
        data[at : at + len(edge)] = edge
    elif kind == 3:
        del data[at:span]
    elif kind == 4:
        data[at:at] = data[at:span] * rng.randint(1, 8)
    elif kind == 5:
        del data[at:]
    else:
        begin = rng.randrange(len(other) + 1)
        data[at:span] = other[begin : begin + rng.choice((4, 16, 256))]


def mutate_text(seed: str, other: str, rng: Random) -> str:
    """Return the text after one to four changes of tokens: swapped, dropped, repeated, replaced by hostile words."""
    tokens, others = _TOKEN.findall(seed), _TOKEN.findall(other)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(tokens)) if tokens else 0
        kind = rng.randrange(6)
        if kind == 0:
            tokens[at : at + 1] = [rng.choice(_WORDS)]
        elif kind == 1:
            del tokens[at : at + rng.choice((1, 1, 3, 20))]
        elif kind == 2:
            tokens[at:at] = tokens[at : at + rng.choice((1, 5, 40))]
        elif kind == 3:
            tokens[at : at + 1] = [rng.choice(others)] if others else []
        elif kind == 4 and tokens:
            tokens[at : at + 1] = [tokens[rng.randrange(len(tokens))]]
        else:
            tokens.insert(at, rng.choice(_WORDS))
    return "".join(tokens)
