"""Results kept by the object they belong to: what is computed once for a machine, or once for a block of samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


class Memo:
    """Results by key; the older half is forgotten when there are ``most``. Safe in several threads: at worst something is computed twice.

    Parts of a key that have no hash (arrays, dictionaries) are known by identity and kept, so that no other object takes their place.
    """

    def __init__(self, most: int = 128) -> None:
        self._most = most
        self._kept: dict[tuple[Any, ...], tuple[Any, tuple[Any, ...]]] = {}

    def __call__(self, make: Callable[[], T], *key: object) -> T:
        """Return ``make()``, or what it returned before for this key."""
        known = tuple(map(_known, key))
        found = self._kept.get(known)
        if found is None:
            if len(self._kept) >= self._most:
                self._kept = dict(list(self._kept.items())[self._most // 2 :])
            found = self._kept[known] = make(), key
        return found[0]


def _known(part: object) -> object:
    try:
        hash(part)
    except TypeError:
        return id(part)
    return part
