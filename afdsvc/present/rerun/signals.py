"""The signals of one machine for the viewer: groups of channels, gaps, bursts shaded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np
import rerun as rr

from afdsvc.api.signals import Block, Channel
from afdsvc.lti.statespace import Array
from afdsvc.present.rerun import paths
from afdsvc.present.rerun.blueprint import GroupLayout
from afdsvc.present.rerun.paths import Columns, time_columns


def envelope(values: Array, width: int) -> tuple[np.ndarray, Array]:
    """Return sample numbers ``(k,)`` and values ``(k, channels)`` of two points per ``width`` samples.

    Each bin keeps its smallest and its largest value per channel, in the order they came; the points stand at its first
    and its middle sample. NaN is passed over unless a whole bin is NaN. Bins of two samples or less are kept.
    """
    n, channels = values.shape
    if width <= 2:
        return np.arange(n), values
    full = n // width
    bins = values[: full * width].reshape(full, width, channels)
    low, high = np.fmin.reduce(bins, axis=1), np.fmax.reduce(bins, axis=1)
    rising = _first_place(bins, low) <= _first_place(bins, high)
    pairs = np.where(rising[:, None, :], np.stack([low, high], axis=1), np.stack([high, low], axis=1))
    starts = np.arange(full) * width
    places = np.stack([starts, starts + width // 2], axis=1).reshape(-1)
    rest = np.arange(full * width, n)
    return np.concatenate([places, rest]), np.concatenate([pairs.reshape(-1, channels), values[full * width :]])


def _first_place(bins: Array, value: Array) -> np.ndarray:
    return np.asarray(np.argmax(bins == value[:, None, :], axis=1))


Groups = Mapping[str, Mapping[str, tuple[Channel, ...]]]  # by view and role
SHADE_STROKES = 240


class SignalGroup:
    """Channels drawn in one view, one entity per role. ``extremes`` is what the view spans so far (low, high)."""

    def __init__(self, machine: str, name: str, quiet_hertz: float) -> None:
        self.machine, self.name, self._quiet = machine, name, quiet_hertz
        self.channels: Mapping[str, tuple[Channel, ...]] = {}
        self.extremes = (np.inf, -np.inf)
        self._columns: dict[Channel, Columns] = {}
        self._end: tuple[str, int] | None = None

    @property
    def layout(self) -> GroupLayout:
        """What the layout must know."""
        units: dict[str, str] = {}
        roles: dict[str, list[str]] = {}
        for role, channels in self.channels.items():
            for c in channels:
                units.setdefault(c.label, c.unit)
                roles.setdefault(c.label, []).append(role)
        return GroupLayout(units, roles)

    def style(self, recording: rr.RecordingStream, channels: Mapping[str, tuple[Channel, ...]]) -> None:
        """Name and colour the lines; called when the set of channels is first seen or changes."""
        self.channels, self._columns = channels, {}
        for role, found in channels.items():
            for i, channel in enumerate(found):
                entity = paths.signal(self.machine, self.name, role, channel.label)
                color = paths.FAINT if role == "ref" else paths.LINES[i % len(paths.LINES)]
                recording.log(entity, _line(role, channel, color), static=True)
                self._columns[channel] = Columns(entity, 1)
        shade = rr.SeriesLines(names="burst", colors=[paths.SHADE], widths=[2.0], aggregation_policy=_EVERY)
        recording.log(paths.shade(self.machine, self.name), shade, static=True)

    def add(self, block: Block) -> None:
        """Take the samples of a block; a gap before it becomes a break in the lines."""
        if self._end is not None and self._end != (block.session, block.k0):
            for columns in self._columns.values():
                columns.add_row(block.t0_ns - 1, np.nan)
        self._end = (block.session, block.k0 + len(block))
        width = 1 if block.burst or not self._quiet else int(2 / (block.dt * self._quiet))
        rows, shown = envelope(block.values[:, [block.channels.index(c) for c in self._columns]], width)
        t_ns = block.t0_ns + np.rint(rows * (block.dt * 1e9)).astype(np.int64)
        for columns, values in zip(self._columns.values(), shown.T, strict=True):
            columns.add(t_ns, values[:, None])
        low, high = float(np.fmin.reduce(shown, axis=None)), float(np.fmax.reduce(shown, axis=None))
        self.extremes = (float(np.fmin(self.extremes[0], low)), float(np.fmax(self.extremes[1], high)))

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
        entity = paths.shade(self.machine, self.name)
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


def _line(role: str, channel: Channel, color: tuple[int, int, int]) -> rr.SeriesLines:
    symbol = "" if role == "aux" else f"{role} "
    name = f"{symbol}{channel.label}" + (f" [{channel.unit}]" if channel.unit else "")
    # Zoomed out, the viewer averages by default, which hides peaks.
    policy = rr.components.AggregationPolicy.MinMax
    return rr.SeriesLines(names=name, colors=[color], widths=[1.0], aggregation_policy=policy)


_EVERY = rr.components.AggregationPolicy.Off
