"""Files that are being written: what ends before it is whole is removed."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

_WRITING: set[Path] = set()  # of this process, for an interruption that cannot wait for `writing` to be left


@contextlib.contextmanager
def writing(*paths: Path) -> Iterator[None]:
    """Remove the files and empty folders that were not there before, when the block ends by an exception of any kind."""
    new = {path for path in paths if not path.exists()}
    _WRITING.update(new)
    try:
        yield
    except BaseException:
        _remove(new)
        raise
    finally:
        _WRITING.difference_update(new)


def remove_unfinished() -> None:
    """Remove whatever is being written at this moment."""
    _remove(set(_WRITING))


def _remove(paths: set[Path]) -> None:
    for path in sorted(paths, reverse=True):  # a folder after what is in it
        with contextlib.suppress(OSError):
            if path.is_dir():
                path.rmdir()
            else:
                path.unlink()
