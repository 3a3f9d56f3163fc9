"""Messages of one kind out of a recording by its index: chunks that hold none of them are never read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader

from afdsvc.errors import BadInput
from afdsvc.files.recording import topics
from afdsvc.files.recording.reader import Recording


def messages_on(path: Path, what: str) -> Iterator[bytes]:
    """Yield the messages of a kind of topic, of every machine, in the order of their time.

    A recording without an index (its writer died) is read through. Raises `BadInput` when it is no recording.
    """
    try:
        with path.open("rb") as stream:
            reader = make_reader(stream)
            summary = reader.get_summary()
            if summary is not None and summary.chunk_indexes:
                names = [c.topic for c in summary.channels.values() if topics.parts(c.topic)[1] == what]
                for _, _, message in reader.iter_messages(topics=names) if names else ():
                    yield message.data
                return
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from error
    except (McapError, ValueError, EOFError):
        pass  # no index, or a damaged one
    yield from (entry.data for entry in Recording(path).messages(None, what))
