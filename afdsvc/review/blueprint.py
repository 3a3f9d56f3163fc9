"""The layout made for this work: one tab per machine; left the signals, right what was decided about them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import rerun.blueprint as rrb

from afdsvc.review import paths

SIDE_BY_SIDE = 3  # with more signals than this a group is drawn in one view
HEIGHTS = {"inputs": 2.0, "excitation": 1.4}  # of the others: 3


@dataclass(frozen=True, slots=True)
class GroupLayout:
    """A group of signals: unit and roles drawn, by label."""

    units: Mapping[str, str]
    roles: Mapping[str, Sequence[str]]


@dataclass(frozen=True, slots=True)
class MachineLayout:
    """What there is to show of one machine: groups of signals, outputs judged by each detector, lanes, any event."""

    groups: Mapping[str, GroupLayout]
    detectors: Mapping[str, int]
    lanes: int
    told: bool


def blueprint(machines: Mapping[str, MachineLayout]) -> rrb.Blueprint:
    """Return the layout of all machines, the whole time range shown."""
    return rrb.Blueprint(
        rrb.Tabs(*(_machine(id, layout) for id, layout in machines.items())),
        rrb.TimePanel(state="collapsed", timeline=paths.SECONDS),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )


def _machine(id: str, layout: MachineLayout) -> rrb.Container:
    rows = [_group(id, name, group) for name, group in layout.groups.items()]
    left = rrb.Vertical(*rows, row_shares=[HEIGHTS.get(name, 3.0) for name in layout.groups])
    right = _decisions(id, layout)
    sides = [side for side, present in ((left, rows), (right, right.contents)) if present]
    return rrb.Horizontal(*sides, name=id, column_shares=[1.2, 1.0][: len(sides)])


def _group(id: str, name: str, group: GroupLayout) -> rrb.Container | rrb.View:
    if not 1 < len(group.units) <= SIDE_BY_SIDE:
        return _signals(id, name, group, list(group.units))
    return rrb.Horizontal(*(_signals(id, name, group, [label]) for label in group.units))


def _signals(id: str, name: str, group: GroupLayout, labels: Sequence[str]) -> rrb.TimeSeriesView:
    entities = [paths.signal(id, name, role, label) for label in labels for role in group.roles[label]]
    units = {group.units[label] for label in labels}
    title = paths.TITLES[name] + (f": {labels[0]}" if len(labels) == 1 else "")
    return rrb.TimeSeriesView(
        origin=paths.group(id, name),
        contents=[paths.shade(id, name), *entities],
        name=title + (f" [{units.pop()}]" if len(units) == 1 and units != {""} else ""),
        axis_x=whole_range(),
        plot_legend=_legend(len(entities) > 1),
    )


def _decisions(id: str, layout: MachineLayout) -> rrb.Container:
    parts: list[tuple[rrb.Container | rrb.View, float]] = []
    plots = [_statistic(id, name, outputs) for name, outputs in layout.detectors.items()]
    if plots:
        parts.append((rrb.Grid(*plots, grid_columns=min(2, len(plots))), 3.0 * math.ceil(len(plots) / 2)))
    if layout.lanes:
        origin = paths.path(id, "states")
        states = rrb.StateTimelineView(origin=origin, name="bursts and decisions", time_view=whole_range())
        parts.append((states, min(1.5 + layout.lanes, 6.0)))
    if layout.told:
        log = rrb.TextLogView(origin=paths.path(id, "log"), name="events", columns=_columns())
        parts.append((log, 5.0))
    return rrb.Vertical(*(part for part, _ in parts), row_shares=[height for _, height in parts])


def _statistic(id: str, detector: str, outputs: int) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=paths.decision(id, detector),
        name=f"{detector}: statistic, threshold in red",
        axis_x=whole_range(),
        plot_legend=_legend(outputs > 1),
    )


def _columns() -> rrb.TextLogColumns:
    kinds = [rrb.components.TextLogColumn(kind) for kind in ("LogLevel", "Body")]
    return rrb.TextLogColumns(timeline_columns=[rrb.components.TimelineColumn(paths.SECONDS)], text_log_columns=kinds)


def _legend(visible: bool) -> rrb.PlotLegend:
    return rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=visible)


def whole_range() -> rrb.TimeAxis:
    """Return an axis that shows everything; by default the viewer opens long recordings at their end."""
    edge = rrb.TimeRangeBoundary.infinite()
    return rrb.TimeAxis(view_range=rrb.TimeRange(start=edge, end=edge))
