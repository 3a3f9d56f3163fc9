"""What a soak left: samples and gaps in the recordings, alarms, bursts, memory."""

from __future__ import annotations

import datetime
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain

from afdsvc.api.intervals import Intervals
from afdsvc.api.signals import Block
from afdsvc.files.recording.reader import Recording
from afdsvc.hal.store import SPILL_SECONDS, blocks
from afdsvc.service.notifications import History, Judged
from afdsvc.wire import codec
from afdsvc.wire.messages import AlarmKind
from benchmarks.soak.disturbances import Disturbance
from benchmarks.soak.testbed import Testbed

NOT_KEPT = re.compile(r"samples (.+) of session (\S+) could not be kept: the store was full or failed")
MARGIN = 15.0  # seconds after a disturbance in which its gap may still begin: a reconnection takes some
LOSING = (
    "recording deleted",
    "rigs hung",
    "rigs killed",
    "clock of rigs stepped",
    "rigs stopped in order",
)  # all others must lose nothing


def gaps(testbed: Testbed, blocks: Iterable[Block], stated: Mapping[str, Intervals]) -> Iterator[tuple[float, float, int, bool]]:
    """Yield the gaps in one machine's samples: Unix time they begin and end at, samples missing, and whether its rig ``stated`` that it could not keep
    them; and at last (0, 0, samples, False)."""
    spans: dict[str, list[tuple[int, int, float, float]]] = {}
    for block in blocks:
        ends = block.k0 + len(block)
        spans.setdefault(block.session, []).append(
            (block.k0, ends, block.t0_ns / 1e9, block.t0_ns / 1e9 + len(block) * block.dt)
        )
    total = 0
    for session, rows in spans.items():
        reached, until = 0, 0.0
        for k0, ends, since, till in sorted(rows):
            if until and k0 > reached:
                yield testbed.true_time(until), testbed.true_time(since), k0 - reached, stated[session].covers(reached, k0)
            total += max(ends - max(k0, reached), 0)
            reached, until = max(reached, ends), max(until, till)
    yield 0.0, 0.0, total, False


def explained(done: Sequence[Disturbance], id: str, start: float, end: float) -> str:
    """Return what was done to the machine around a gap and may lose samples, "" when nothing was.

    A rig that is killed loses what was not acknowledged and not on its disk yet: of the `SPILL_SECONDS` before, too.
    """
    return " and ".join(
        sorted(
            {d.what for d in done if d.what in LOSING and id in d.machines and start <= d.end + MARGIN and end >= d.start - SPILL_SECONDS - 1.0}
        )
    )


def stored(testbed: Testbed, id: str) -> Iterator[Block]:
    """Yield what a rig keeps on its disk, to be delivered when it is started again."""
    for path in testbed.folder.glob(f"store/{id}.*.blocks"):
        yield from (codec.decode_block(data) for _, data in blocks(path))


def recorded(testbed: Testbed, id: str) -> Iterator[Block]:
    """Yield the blocks of all recordings of a machine."""
    for path in (testbed.folder / "recordings").glob(f"{id}-2*.mcap"):
        yield from Recording(path).blocks()


def stated_losses(testbed: Testbed, id: str) -> dict[str, Intervals]:
    """Return the samples of every session that the rig said it could not keep, in the events of its recordings."""
    found: dict[str, Intervals] = defaultdict(Intervals)
    for path in (testbed.folder / "recordings").glob(f"{id}-2*.mcap"):
        for event in Recording(path).events():
            if said := NOT_KEPT.fullmatch(event.cause):
                for start, last in re.findall(r"(\d+) to (\d+)", said[1]):
                    found[said[2]].add(int(start), int(last) + 1)
    return found


def count_samples(testbed: Testbed, done: Sequence[Disturbance]) -> tuple[int, Counter[str], Counter[str], list[str]]:
    """Return samples, gaps and samples missing by what was done then, and sentences about gaps nothing explains."""
    samples, accounted, missing, wrong = 0, Counter[str](), Counter[str](), []
    for id in testbed.ids:
        for start, end, n, full in gaps(testbed, chain(recorded(testbed, id), stored(testbed, id)), stated_losses(testbed, id)):
            if not start:
                samples += n
            elif full:
                accounted["store of the rig full, as it stated"] += 1
                missing["store of the rig full, as it stated"] += n
            elif why := explained(done, id, start, end):
                accounted[why] += 1
                missing[why] += n
            else:
                wrong.append(
                    f"{id}: {n} samples missing from {datetime.datetime.fromtimestamp(start, datetime.UTC):%H:%M:%S}, unexplained"
                )
    return samples, accounted, missing, wrong


def count_alarms(testbed: Testbed) -> tuple[int, list[Judged], list[str], list[str]]:
    """Return the machines whose fault was identified rightly, bursts judged on healthy machines, false alarms, and faults missed or misidentified.

    Bursts are those that the service's history says were judged: of those asked for, some are cut short, or made for identification, and raise
    nothing; recordings, which hold them too, are deleted.
    """
    history = History(testbed.folder / "recordings" / "soak-alarms.sqlite")
    raised = [c.alarm for c in history.changes(limit=100_000) if c.event == "raised"]
    faults = [a for a in raised if a.kind is AlarmKind.FAULT]
    named = {a.machine for a in faults if a.fault == testbed.faults.get(a.machine)}
    healthy = [judged for id in testbed.ids if id not in testbed.faults for judged in history.judged(id)]
    false = [f"{a.id}: {a.sentence}" for a in faults if a.machine not in testbed.faults]
    beside = [
        f"{a.id} beside {testbed.faults[a.machine]}"
        for a in faults
        if a.machine in testbed.faults
        and a.fault not in ("unnamed", testbed.faults[a.machine])  # unnamed until a burst says which
    ]
    return (
        len(named),
        healthy,
        false,
        [*(f"{id}: {fault} was never named" for id, fault in testbed.faults.items() if id not in named), *beside],
    )


def bursts(testbed: Testbed) -> dict[str, int]:
    """Return how many bursts were asked of each machine."""
    return {
        id: len(
            {r.burst.name for path in (testbed.folder / "recordings").glob(f"{id}-2*.mcap") for r in Recording(path).requests()}
        )
        for id in testbed.ids
    }


def growth(resident: Sequence[tuple[float, int, int]]) -> tuple[str, float]:
    """Return how the memory of the service's last process went after its first third, and by how many percent.

    ``resident``: Unix time, process, bytes.
    """
    rows = [(t, m) for t, pid, m in resident if pid == resident[-1][1] and m] if resident else []
    if len(rows) < 12:
        return "too short to say", 0.0
    warm = rows[len(rows) // 3 :]
    half = len(warm) // 2
    first, last = (sum(m for _, m in part) / len(part) for part in (warm[:half], warm[half:]))
    percent = 100 * (last / first - 1)
    span, before = warm[-1][0] - warm[0][0], warm[0][0] - rows[0][0]
    return f"{first / 1e6:.0f} MB, then {last / 1e6:.0f} MB ({percent:+.1f} %) over {span:.0f} s after {before:.0f} s", percent


def processor(used: Sequence[tuple[float, int, float]]) -> float:
    """Return how much of a core [%] the service's last process used after its first third; ``used``: Unix time, process, seconds."""
    rows = [(t, seconds) for t, pid, seconds in used if pid == used[-1][1] and seconds]
    if len(rows) < 3:
        return float("nan")
    (began, first), (over, last) = rows[len(rows) // 3], rows[-1]
    return 100 * (last - first) / (over - began)
