"""Reading a recording: blocks, traces, events, decisions, model and site, and what was lost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema

from afdsvc.api.model import Model
from afdsvc.api.signals import Block, Trace
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import parse_model
from afdsvc.files.recording import topics
from afdsvc.files.recording.mcap_records import End, Loss, read_items, summary_channels
from afdsvc.files.recording.traces import traces_of
from afdsvc.wire import codec
from afdsvc.wire.messages import BurstRequest, Finding, RigDescription, RigEvent

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Entry:
    """One message of a recording; ``schema`` is the name of its type."""

    topic: str
    schema: str
    t_ns: int
    sequence: int
    data: bytes


class Recording:
    """A recording on disk, finished or not. Opening it reads it once through; samples are read again when asked for.

    Raises `BadInput` when the file is no MCAP file. Damage raises nothing: what is complete is given, and `loss` says
    what is not.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: dict[str, bytes] = {}
        self.losses: list[Loss] = []
        self.finished = False
        self.counts: Counter[str] = Counter()
        self._unreadable: dict[tuple[str, int, int], str] = {}
        self._known: list[McapRecord] | None = None
        self._topics: dict[int, str] = {}
        for item in self._items():
            self._take(item)

    @property
    def machines(self) -> tuple[str, ...]:
        """Ids of the machines with samples, in order of appearance."""
        found = [topics.parts(name) for name in self.counts]
        return tuple(machine for machine, what in found if what == topics.BLOCK)

    @property
    def site(self) -> str:
        """Text of the site file, "" when the recording carries none."""
        return self.attachments.get("site.toml", b"").decode(errors="replace")

    @property
    def loss(self) -> str:
        """What could not be read, in sentences; "" when the recording is whole."""
        sentences = [loss.sentence for loss in self.losses] + list(self._unreadable.values())
        if not self.finished:
            sentences.append("the file was not closed: its writer failed, or is still writing")
        if not sentences:
            return ""
        more = f"; and {len(sentences) - 5} more" if len(sentences) > 5 else ""
        return f"{self.path}: {'; '.join(sentences[:5])}{more}"

    def model(self, machine: str, allow_code: bool = False) -> Model | None:
        """Return the model the recording carries for a machine, None without; raises `BadInput` as for a file."""
        name = f"{machine}/model.toml"
        if name not in self.attachments:
            return None
        return parse_model(self.attachments[name].decode(errors="replace"), f"{self.path}:{name}", allow_code)

    def messages(self, machine: str | None = None, what: str | None = None) -> Iterator[Entry]:
        """Yield the messages of one machine and one kind of topic (None: any), in the order of the file."""
        schemas: dict[int, str] = {}
        channels: dict[int, Channel] = {}
        for item in self._items():
            if isinstance(item, Schema):
                schemas[item.id] = item.name
            elif isinstance(item, Channel):
                channels[item.id] = item
            elif isinstance(item, Message):
                channel = channels[item.channel_id]
                who, kind = topics.parts(channel.topic)
                if machine in (None, who) and what in (None, kind):
                    schema = schemas.get(channel.schema_id, "")
                    yield Entry(channel.topic, schema, item.log_time, item.sequence, item.data)

    def records(self) -> Iterator[McapRecord]:
        """Yield every readable record as the file holds it, each message after its channel and schema."""
        return (item for item in self._items() if not isinstance(item, (Loss, End)))

    def blocks(self, machine: str | None = None) -> Iterator[Block]:
        """Yield the blocks in the order of the file; unreadable ones are named in `loss`."""
        return self._decoded(machine, topics.BLOCK, codec.decode_block)

    def residuals(self, machine: str | None = None) -> Iterator[Block]:
        """Yield the recorded whitened residuals."""
        return self._decoded(machine, topics.RESIDUAL, codec.decode_block)

    def events(self, machine: str | None = None) -> Iterator[RigEvent]:
        """Yield the events of the rigs."""
        return self._decoded(machine, topics.EVENT, codec.decode_event)

    def findings(self, machine: str | None = None) -> Iterator[Finding]:
        """Yield the decisions of the detectors."""
        return self._decoded(machine, topics.FINDING, codec.decode_finding)

    def requests(self, machine: str | None = None) -> Iterator[BurstRequest]:
        """Yield the bursts that were asked for."""
        return self._decoded(machine, topics.REQUEST, codec.decode_burst_request)

    def descriptions(self, machine: str | None = None) -> Iterator[RigDescription]:
        """Yield what the rigs said of themselves."""
        return self._decoded(machine, topics.DESCRIPTION, codec.decode_description)

    def traces(self, machine: str | None = None) -> list[Trace]:
        """Return the samples as traces without gaps; raises `BadInput` when there are none."""
        found = traces_of(self.blocks(machine), self.path.name, float(self.metadata.get("import", {}).get("t0", 0)))
        if not found:
            held = ", ".join(self.counts) or "no messages at all"
            wanted = f"blocks of machine '{machine}'" if machine else "blocks (afdsvc.v1.Block)"
            raise BadInput(f"{self.path}: holds no samples; expected {wanted}, and it has {held}")
        return found

    def _decoded(self, machine: str | None, what: str, decode: Callable[[bytes], T]) -> Iterator[T]:
        for entry in self.messages(machine, what):
            try:
                yield decode(entry.data)
            except BadInput as error:
                self._unreadable[entry.topic, entry.t_ns, entry.sequence] = f"a message of {entry.topic}: {error}"

    def _items(self) -> Iterator[McapRecord | Loss | End]:
        """Yield the records of the file; a message whose channel is unknown (its chunk is damaged) is a loss."""
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

    def _take(self, item: McapRecord | Loss | End) -> None:
        if isinstance(item, Loss):
            self.losses.append(item)
        elif isinstance(item, End):
            self.finished = item.finished
        elif isinstance(item, Metadata):
            self.metadata.setdefault(item.name, {}).update(item.metadata)
        elif isinstance(item, Attachment):
            self.attachments[item.name] = item.data
        elif isinstance(item, Channel):
            self._topics[item.id] = item.topic
        elif isinstance(item, Message):
            self.counts[self._topics[item.channel_id]] += 1
