"""Reading Rerun files back, and a machine to review."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from rerun.chunk import RrdReader

from afdsvc.api.evidence import Evidence, Severity
from afdsvc.api.signals import Block, Channel
from afdsvc.wire.messages import Finding

T0, DT, LENGTH = 1_763_000_000_000_000_000, 1e-3, 50
CHANNELS = tuple(Channel(f"{role}_{label}", "um") for role in ("u", "y", "alpha", "beta") for label in ("h", "v"))


class Rrd:
    """What stands in a Rerun file, by entity."""

    def __init__(self, path: Path) -> None:
        self.reader = RrdReader(path)
        self.chunks = list(self.reader.stream())

    @property
    def entities(self) -> set[str]:
        return {c.entity_path for c in self.chunks if not c.entity_path.startswith("/__")}

    def rows(self, entity: str, component: str = "Scalars:scalars") -> list[tuple[int, object]]:
        """Return (nanoseconds since the start, first value) in order of time; None for an empty cell."""
        found = []
        for chunk in self.chunks:
            batch = chunk.to_record_batch()
            if chunk.entity_path == entity and not chunk.is_static and component in batch.schema.names:
                t = batch.column("seconds").cast(pa.int64()).to_pylist()
                found += zip(t, (v[0] if v else None for v in batch.column(component).to_pylist()), strict=True)
        return sorted(found, key=lambda row: row[0])

    def static(self, entity: str, component: str) -> object:
        """Return the latest value logged without time."""
        found = [
            chunk.to_record_batch().column(component).to_pylist()[-1]
            for chunk in self.chunks
            if chunk.entity_path == entity and chunk.is_static and component in chunk.to_record_batch().schema.names
        ]
        return found[-1]


@pytest.fixture
def rrd() -> type[Rrd]:
    return Rrd


@pytest.fixture
def blocks() -> Callable[..., list[Block]]:
    def make(count: int, bursts: tuple[int, ...] = (), machine: str = "m1", channels=CHANNELS) -> list[Block]:
        rng = np.random.default_rng(7)
        return [
            Block(
                machine, "s1", seq, seq * LENGTH, DT, T0 + seq * 50_000_000, channels,
                rng.normal(size=(LENGTH, len(channels))), f"b{seq}" if seq in bursts else "",
            )
            for seq in range(count)
        ]  # fmt: skip

    return make


@pytest.fixture
def finding() -> Callable[..., Finding]:
    def make(seconds: float, statistic: float, output: str = "", **fields) -> Finding:
        given = {
            "detected": statistic > 9.0,
            "fault": "sensor" if statistic > 9.0 else None,
            "severity": Severity(-0.5, 0.1),
        }
        e = Evidence("matched_filter", "m1", 0, seconds, statistic, 9.0, output=output, **(given | fields))
        return Finding(e, "s1", T0 + round(seconds * 1e9))

    return make
