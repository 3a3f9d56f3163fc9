"""The signals of one machine on their way to the viewer: groups of channels, gaps, bursts shaded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np
import rerun as rr

from afdsvc.api.signals import Block, Channel
from afdsvc.review import paths
from afdsvc.review.columns import Columns, time_columns
from afdsvc.review.envelope import envelope

Groups = Mapping[str, Mapping[str, tuple[Channel, ...]]]  # by view and role
SHADE_STROKES = 300


class SignalGroup:
    """Channels drawn in one view, one entity per role. ``extremes`` is what the view spans so far (low, high)."""

    def __init__(self, machine: str, name: str, quiet_hertz: float) -> None:
        self.machine, self.name, self._quiet = machine, name, quiet_hertz
        self.channels: Mapping[str, tuple[Channel, ...]] = {}
        self.extremes = (np.inf, -np.inf)
        self._columns: dict[str, Columns] = {}
        self._end: tuple[str, int] | None = None

    @property
    def unit(self) -> str:
        """The unit of all channels, "" when they have several."""
        units = {c.unit for found in self.channels.values() for c in found}
        return units.pop() if len(units) == 1 else ""

    def style(self, recording: rr.RecordingStream, channels: Mapping[str, tuple[Channel, ...]]) -> None:
        """Name and colour the lines; called when the set of channels is first seen or changes."""
        self.channels, self._columns = channels, {}
        offset = 0
        for role, found in channels.items():
            colors = [paths.LINES[(offset + i) % len(paths.LINES)] for i in range(len(found))]
            offset += len(found)
            entity = paths.group(self.machine, self.name, role)
            recording.log(entity, _lines([_legend(role, c) for c in found], colors), static=True)
            self._columns[role] = Columns(entity, len(found))
        # Drawn first, so that signals lie on top: the viewer goes by the alphabet.
        shade = rr.SeriesLines(names="burst", colors=[paths.SHADE], widths=[2.0], aggregation_policy=_EVERY)
        recording.log(paths.group(self.machine, self.name, "_burst"), shade, static=True)

    def add(self, block: Block) -> None:
        """Take the samples of a block; a gap before it becomes a break in the lines."""
        if self._end is not None and self._end != (block.session, block.k0):
            for columns in self._columns.values():
                columns.add_row(block.t0_ns - 1, *[np.nan] * columns.width)
        self._end = (block.session, block.k0 + len(block))
        width = 1 if block.burst or not self._quiet else int(2 / (block.dt * self._quiet))
        for role, channels in self.channels.items():
            rows, shown = envelope(block.values[:, [block.channels.index(c) for c in channels]], width)
            self._columns[role].add(block.t0_ns + np.rint(rows * (block.dt * 1e9)).astype(np.int64), shown)
            if np.isfinite(shown).any():
                low, high = np.nanmin(shown), np.nanmax(shown)
                self.extremes = (min(self.extremes[0], low), max(self.extremes[1], high))

    def send(self, recording: rr.RecordingStream, start_ns: int) -> None:
        """Send what was collected."""
        for columns in self._columns.values():
            columns.send(recording, start_ns)

    def shade(self, recording: rr.RecordingStream, begin_ns: int, end_ns: int, start_ns: int) -> None:
        """Fill a span of time over the height of the view, with strokes up and down (a plot has no areas)."""
        low, high = self.extremes
        if not low < high:
            return
        t_ns = np.linspace(begin_ns - start_ns, end_ns - start_ns, SHADE_STROKES).astype(np.int64) + start_ns
        values = np.where(np.arange(SHADE_STROKES) % 2, high, low)
        t_ns = np.concatenate([[begin_ns - 1], t_ns, [end_ns + 1]])
        values = np.concatenate([[np.nan], values, [np.nan]])
        entity = paths.group(self.machine, self.name, "_burst")
        recording.send_columns(entity, indexes=time_columns(t_ns, start_ns), columns=rr.Scalars.columns(scalars=values))


@lru_cache(maxsize=256)
def by_group(channels_of_block: tuple[Channel, ...]) -> Groups:
    """Return the channels of a block by group and role; groups without channels are left out."""
    found: dict[str, dict[str, tuple[Channel, ...]]] = {}
    for name, roles in paths.GROUPS.items():
        channels = {role: tuple(c for c in channels_of_block if c.role == role) for role in roles}
        present = {role: cs for role, cs in channels.items() if cs}
        if present:
            found[name] = present
    return found


def as_residual(block: Block) -> Block:
    """Return a residual block (channels ``aux_r_<output>``) with plain channel labels."""
    channels = tuple(Channel(f"aux_{c.label.removeprefix('r_')}", c.unit) for c in block.channels)
    return replace(block, channels=channels)


def _legend(role: str, channel: Channel) -> str:
    symbol = "" if role in ("y", "aux") else f"{role} "
    return f"{symbol}{channel.label}" + (f" [{channel.unit}]" if channel.unit else "")


def _lines(names: list[str], colors: list[tuple[int, int, int]]) -> rr.SeriesLines:
    # Zoomed out, the viewer averages unless told otherwise, and peaks vanish.
    policy = rr.components.AggregationPolicy.MinMax
    return rr.SeriesLines(names=names, colors=colors, widths=[1.0] * len(names), aggregation_policy=policy)


_EVERY = rr.components.AggregationPolicy.Off
