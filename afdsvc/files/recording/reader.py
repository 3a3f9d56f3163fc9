"""Reading a recording: blocks, joined to traces without gaps, events, decisions, model and site, and what was lost."""

from __future__ import annotations

import sys
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema

from afdsvc.api.model import Model
from afdsvc.api.signals import Block, Trace
from afdsvc.api.signals import Channel as Signal
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import parse_model
from afdsvc.files.recording import mcap_file
from afdsvc.files.recording.mcap_records import End, Item, Loss, read_items, summary_channels
from afdsvc.files.validation import file_size, items_in_time
from afdsvc.wire import codec
from afdsvc.wire.messages import BurstRequest, Finding, RetuneRequest, RigDescription, RigEvent

Decoded = Block | RigEvent | Finding | BurstRequest | RetuneRequest | RigDescription
_DECODE: dict[str, Callable[[bytes], Decoded]] = {
    mcap_file.BLOCK: codec.decode_block, mcap_file.RESIDUAL: codec.decode_block, mcap_file.EVENT: partial(codec.decode, RigEvent),
    mcap_file.FINDING: partial(codec.decode, Finding), mcap_file.REQUEST: partial(codec.decode, BurstRequest),
    mcap_file.DESCRIPTION: partial(codec.decode, RigDescription), mcap_file.RETUNING: partial(codec.decode, RetuneRequest),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class RecordedMessage:
    """One message of a recording; ``schema`` is the name of its type."""

    topic: str
    schema: str
    t_ns: int
    sequence: int
    data: bytes


@dataclass
class Contents:
    """What a recording holds besides its messages, as far as it was read; ``counts`` are messages by topic."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    losses: list[Loss] = field(default_factory=list)
    finished: bool = False
    counts: Counter[str] = field(default_factory=Counter)
    topics: dict[int, str] = field(default_factory=dict)

    def take(self, item: Item) -> None:
        """Take one record."""
        if isinstance(item, Message):
            self.counts[self.topics[item.channel_id]] += 1
        elif isinstance(item, Channel):
            self.topics[item.id] = item.topic
        elif isinstance(item, Loss):
            self.losses.append(item)
        elif isinstance(item, End):
            self.finished = item.finished
        elif isinstance(item, Metadata):
            self.metadata.setdefault(item.name, {}).update(item.metadata)
        elif isinstance(item, Attachment):
            self.attachments[item.name] = item.data


class Recording:
    """A recording on disk, finished or not. Opening it reads up to the first message; the first pass over its messages goes on there.

    What is known only at the end (counts, machines, loss) costs a pass unless there has been one. Raises `BadInput` when the file is
    no MCAP file. Damage raises nothing: what is complete is given, and `loss` says what is not.
    """

    def __init__(self, path: str | Path) -> None:
        self.path, self.front = Path(path), Contents()
        self._size = file_size(self.path, sys.maxsize)
        self._unreadable: dict[tuple[str, int, int], str] = {}
        self._known: list[McapRecord] | None = None
        self._contents: Contents | None = None
        self._ahead: list[Item] = []
        self._rest: Iterator[Item] | None = self._defined()
        for item in self._rest:
            self._ahead.append(item)
            self.front.take(item)
            if isinstance(item, Message):
                break

    @property
    def contents(self) -> Contents:
        """What the whole file holds."""
        if self._contents is None:
            deque(self.items(), maxlen=0)
        return self._contents or self.front

    @property
    def counts(self) -> Counter[str]:
        """Messages by topic."""
        return self.contents.counts

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Facts by name."""
        return self.contents.metadata

    @property
    def attachments(self) -> dict[str, bytes]:
        """Attached files by name."""
        return self.contents.attachments

    @property
    def description(self) -> dict[str, bytes]:
        """Site and models by name: what was attached in front of the first message, if there is anything, else everything."""
        return self.front.attachments or self.attachments

    @property
    def machines(self) -> tuple[str, ...]:
        """Ids of the machines with samples, in order of appearance."""
        found = [mcap_file.parts(name) for name in self.counts]
        return tuple(machine for machine, what in found if what == mcap_file.BLOCK)

    @property
    def site(self) -> str:
        """Text of the site file, "" when the recording carries none."""
        return self.description.get("site.toml", b"").decode(errors="replace")

    @property
    def loss(self) -> str:
        """What could not be read, in sentences; "" when the recording is whole."""
        sentences = [loss.sentence for loss in self.contents.losses] + list(self._unreadable.values())
        if not self.contents.finished:
            sentences.append("the file was not closed: its writer failed, or is still writing")
        if not sentences:
            return ""
        more = f"; and {len(sentences) - 5} more" if len(sentences) > 5 else ""
        return f"{self.path}: {'; '.join(sentences[:5])}{more}"

    def model(self, machine: str, allow_code: bool = False) -> Model | None:
        """Return the model the recording carries for a machine, None without; raises `BadInput` as for a file."""
        name = f"{machine}/model.toml"
        if name not in self.description:
            return None
        return parse_model(self.description[name].decode(errors="replace"), f"{self.path}:{name}", allow_code)

    def items(self) -> Generator[Item, None, None]:
        """Yield every record, and every loss, in one pass over the file; a message whose channel is undefined is a loss."""
        ahead, rest, contents = self._ahead, self._rest or self._defined(), Contents()
        self._ahead, self._rest = [], None
        for item in chain(ahead, rest):
            contents.take(item)
            yield item
        self._contents = contents

    def messages(self, machine: str | None = None, what: str | Sequence[str] = ()) -> Iterator[RecordedMessage]:
        """Yield the messages of one machine (None: any) and these kinds of topics (none: all), in the order of the file."""
        kinds = (what,) if isinstance(what, str) else what
        schemas: dict[int, str] = {}
        channels: dict[int, Channel] = {}
        for item in self.items():
            if isinstance(item, Schema):
                schemas[item.id] = item.name
            elif isinstance(item, Channel):
                channels[item.id] = item
            elif isinstance(item, Message):
                channel = channels[item.channel_id]
                who, kind = mcap_file.parts(channel.topic)
                if machine in (None, who) and (not kinds or kind in kinds):
                    schema = schemas.get(channel.schema_id, "")
                    yield RecordedMessage(channel.topic, schema, item.log_time, item.sequence, item.data)

    def records(self) -> Iterator[McapRecord]:
        """Yield every readable record as the file holds it, each message after its channel and schema."""
        return (item for item in self.items() if not isinstance(item, (Loss, End)))

    def blocks(self, machine: str | None = None) -> Iterator[Block]:
        """Yield the blocks in the order of the file; unreadable ones are named in `loss`."""
        return (b for _, b in self.decoded(machine, mcap_file.BLOCK) if isinstance(b, Block))

    def residuals(self, machine: str | None = None) -> Iterator[Block]:
        """Yield the recorded whitened residuals."""
        return (b for _, b in self.decoded(machine, mcap_file.RESIDUAL) if isinstance(b, Block))

    def events(self, machine: str | None = None) -> Iterator[RigEvent]:
        """Yield the events of the rigs."""
        return (e for _, e in self.decoded(machine, mcap_file.EVENT) if isinstance(e, RigEvent))

    def findings(self, machine: str | None = None) -> Iterator[Finding]:
        """Yield the decisions of the detectors."""
        return (f for _, f in self.decoded(machine, mcap_file.FINDING) if isinstance(f, Finding))

    def requests(self, machine: str | None = None) -> Iterator[BurstRequest]:
        """Yield the bursts that were asked for."""
        return (r for _, r in self.decoded(machine, mcap_file.REQUEST) if isinstance(r, BurstRequest))

    def retunings(self, machine: str | None = None) -> Iterator[RetuneRequest]:
        """Yield every Q that was asked for."""
        return (r for _, r in self.decoded(machine, mcap_file.RETUNING) if isinstance(r, RetuneRequest))

    def descriptions(self, machine: str | None = None) -> Iterator[RigDescription]:
        """Yield what the rigs said of themselves."""
        return (d for _, d in self.decoded(machine, mcap_file.DESCRIPTION) if isinstance(d, RigDescription))

    def traces(self, machine: str | None = None) -> list[Trace]:
        """Return the samples as traces without gaps; raises `BadInput` when there are none."""
        return self.joined(list(self.blocks(machine)), machine)

    def joined(self, blocks: Sequence[Block], machine: str | None = None) -> list[Trace]:
        """Return blocks of this recording as `traces` does."""
        found = traces_of(blocks, self.path.name, float(self.metadata.get("import", {}).get("t0", 0)))
        if not found:
            held = ", ".join(self.counts) or "no messages at all"
            expected = f"blocks of machine '{machine}'" if machine else "blocks (afdsvc.v1.Block)"
            raise BadInput(f"{self.path}: holds no samples; expected {expected}, and it has {held}")
        return found

    def decoded(self, machine: str | None, *what: str) -> Iterator[tuple[str, Decoded]]:
        """Yield machine and object of the messages of these kinds, in one pass; unreadable ones are named in `loss`."""
        return items_in_time(self._decoded(machine, what), self.path, self._size)

    def _decoded(self, machine: str | None, what: Sequence[str]) -> Iterator[tuple[str, Decoded]]:
        for entry in self.messages(machine, what):
            who, kind = mcap_file.parts(entry.topic)
            try:
                yield who, _DECODE[kind](entry.data)
            except BadInput as error:
                self._unreadable[entry.topic, entry.t_ns, entry.sequence] = f"a message of {entry.topic}: {error}"

    def _defined(self) -> Iterator[Item]:
        channels: set[int] = set()
        for item in read_items(self.path):
            if isinstance(item, Channel):
                channels.add(item.id)
            elif isinstance(item, Message) and item.channel_id not in channels:
                repeated = self._repeated()
                channels |= {r.id for r in repeated if isinstance(r, Channel)}
                yield from repeated
            if isinstance(item, Message) and item.channel_id not in channels:
                yield Loss(f"a message of {len(item.data)} bytes belongs to an undefined channel", item.log_time)
            else:
                yield item

    def _repeated(self) -> list[McapRecord]:
        if self._known is None:
            self._known = list(summary_channels(self.path))
        return self._known


def messages_on(path: Path, what: str) -> Iterator[bytes]:
    """Yield the messages of a kind of topic, of every machine, in the order of their time.

    A recording without an index (its writer died) is read through. Raises `BadInput` when it is not a recording.
    """
    try:
        with path.open("rb") as stream:
            reader = make_reader(stream)
            summary = reader.get_summary()
            if summary is not None and summary.chunk_indexes:
                names = [c.topic for c in summary.channels.values() if mcap_file.parts(c.topic)[1] == what]
                for _, _, message in reader.iter_messages(topics=names) if names else ():
                    yield message.data
                return
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from error
    except (McapError, ValueError, EOFError):
        pass  # no index, or a damaged one
    yield from (entry.data for entry in Recording(path).messages(None, what))


Stream = tuple[str, str, tuple[Signal, ...], float]


def traces_of(blocks: Iterable[Block], name: str, t0: float = 0.0) -> list[Trace]:
    """Return one trace per machine, session, set of channels and uninterrupted stretch, in order of appearance.

    Late blocks are put in their place, repeated ones dropped. ``t0`` [s] is the time of sample 0. The notes of a trace
    name machine, session, index (``k0``) and Unix time (``t0_ns``) of its first sample, and samples ``lost`` before it.
    Raises `BadInput` when blocks overlap with different samples: two rigs spoke under one name.
    """
    streams: dict[Stream, list[Block]] = {}
    for block in blocks:
        streams.setdefault((block.machine, block.session, block.channels, block.dt), []).append(block)
    return [_trace(run, lost, name, t0) for found in streams.values() for run, lost in _runs(found)]


def _runs(blocks: list[Block]) -> Iterator[tuple[list[Block], int]]:
    """Yield stretches without gap, each with the number of samples missing before it."""
    run: list[Block] = []
    lost = 0
    for block in sorted(blocks, key=lambda b: b.k0):
        end = run[-1].k0 + len(run[-1]) if run else block.k0
        if block.k0 < end:
            _refuse_overlap(run[-1], block)
        elif block.k0 == end:
            run.append(block)
        else:
            yield run, lost
            run, lost = [block], block.k0 - end
    if run:
        yield run, lost


def _refuse_overlap(one: Block, other: Block) -> None:
    if one.k0 != other.k0 or one.values.tobytes() != other.values.tobytes():
        raise BadInput(
            f"machine '{one.machine}', session '{one.session}': blocks {one.seq} and {other.seq} both hold sample "
            f"{other.k0}, with different contents; expected one rig per machine id"
        )


def _trace(run: list[Block], lost: int, name: str, t0: float) -> Trace:
    first = run[0]
    notes = {
        "machine": first.machine, "session": first.session, "k0": str(first.k0), "t0_ns": str(first.t0_ns),
        "lost": str(lost),
    }  # fmt: skip
    values = np.concatenate([block.values for block in run])
    return Trace(name, first.dt, first.channels, values, t0 + first.k0 * first.dt, notes)
