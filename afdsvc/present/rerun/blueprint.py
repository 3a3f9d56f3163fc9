"""The layout of the viewer, one tab per machine: answers on top, signals below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import rerun as rr
import rerun.blueprint as rrb

from afdsvc.present.rerun import paths

SIDE_BY_SIDE = 3  # with more signals than this a group is drawn in one view
SIGNAL_TABS = {"signals: outputs and inputs": ("outputs", "inputs", "excitation"), "residuals": ("residual", "whitened"), "other signals": ("aux",)}
HEIGHTS = {"inputs": 2.0, "excitation": 1.4}  # of the others: 3


@dataclass(frozen=True, slots=True)
class GroupLayout:
    """A group of signals: unit and roles drawn, by label."""

    units: Mapping[str, str]
    roles: Mapping[str, Sequence[str]]


@dataclass(frozen=True, slots=True)
class MachineLayout:
    """What there is to show of one machine: groups of signals, outputs judged by each detector, lanes, any event, whether a
    severity was estimated, and its complex planes by title and half width."""

    groups: Mapping[str, GroupLayout]
    detectors: Mapping[str, int]
    lanes: int
    reported: bool
    severity: bool = False
    planes: Sequence[tuple[str, float]] = ()


def blueprint(machines: Mapping[str, MachineLayout], side_by_side: bool = False) -> rrb.Blueprint:
    """Return the layout of all machines, the whole time range shown; ``side_by_side`` compares up to four of them at a glance."""
    whole = [_machine(id, layout) for id, layout in machines.items()]
    if side_by_side and len(machines) > 1:
        whole = [_compared(list(machines.items())[i : i + SIDE_BY_SIDE]) for i in range(0, len(machines), SIDE_BY_SIDE)] + whole
    return rrb.Blueprint(
        rrb.Tabs(*whole),
        rrb.TimePanel(state="collapsed", timeline=paths.SECONDS),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )


def _compared(machines: Sequence[tuple[str, MachineLayout]]) -> rrb.Container:
    columns = []
    for id, layout in machines:
        parts: list[rrb.Container | rrb.View] = [_answer(id), _lanes(id), _severity(id)]
        parts += [_group(id, name, layout.groups[name]) for name in ("outputs", "whitened") if name in layout.groups]
        columns.append(rrb.Vertical(*parts, name=id, row_shares=[2.4, 2.6, 1.6, 1.4, 1.4][: len(parts)]))
    return rrb.Horizontal(*columns, name="side by side")


def _machine(id: str, layout: MachineLayout) -> rrb.Container:
    """Answers first, in the order they are asked for; then what part and how severe; then what the machine did."""
    top = [_answer(id), *([_lanes(id)] if layout.lanes else [])]
    middle: list[rrb.View] = [*([_severity(id), _sure(id)] if layout.severity else []), *_planes(id, layout.planes)]
    rows: list[tuple[rrb.Container, float]] = [(rrb.Horizontal(*top, column_shares=[1.0, 1.8][: len(top)]), 3.8)]
    if middle:
        rows.append((rrb.Horizontal(*middle, column_shares=[1.0, 1.0, 1.2, 1.2][: len(middle)]), 3.6))
    rows.append((_did(id, layout), 4.6))
    return rrb.Vertical(*(row for row, _ in rows), name=id, row_shares=[share for _, share in rows])


def _answer(id: str) -> rrb.TextDocumentView:
    return rrb.TextDocumentView(origin=paths.path(id, "answer"), name=f"{id}: is something wrong")


def _lanes(id: str) -> rrb.StateTimelineView:
    return rrb.StateTimelineView(origin=paths.path(id, "states"), name="since when: bursts and decisions", time_view=whole_range())


def _severity(id: str) -> rrb.TimeSeriesView:
    """Return severities, from nothing to total loss."""
    return rrb.TimeSeriesView(
        origin=paths.path(id, "severity"), name="which part, how severe [%]", axis_x=whole_range(),
        axis_y=rrb.ScalarAxis(range=(-105.0, 5.0)), plot_legend=_legend(True),
    )  # fmt: skip


def _sure(id: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=paths.path(id, "sure"), name="how sure: weights [%]", axis_x=whole_range(),
        axis_y=rrb.ScalarAxis(range=(-3.0, 103.0)), plot_legend=_legend(True),
    )  # fmt: skip


def _planes(id: str, planes: Sequence[tuple[str, float]]) -> list[rrb.Spatial2DView]:
    return [
        rrb.Spatial2DView(
            origin=paths.plane(id, i), name=title, visual_bounds=rrb.VisualBounds2D(x_range=(-size, size), y_range=(-size, size)),
            background=rr.components.Color([0, 0, 0]),
        )
        for i, (title, size) in enumerate(planes[:SIDE_BY_SIDE])
    ]  # fmt: skip


def _did(id: str, layout: MachineLayout) -> rrb.Container:
    """Return what the machine did: its signals by kind, statistics, events."""
    tabs: list[rrb.Container] = []
    for title, names in SIGNAL_TABS.items():
        present = [name for name in names if name in layout.groups]
        if present:
            rows = [_group(id, name, layout.groups[name]) for name in present]
            tabs.append(rrb.Vertical(*rows, name=title, row_shares=[HEIGHTS.get(name, 3.0) for name in present]))
    plots = [_statistic(id, name, outputs) for name, outputs in layout.detectors.items()]
    if plots:
        tabs.append(rrb.Grid(*plots, grid_columns=min(2, len(plots)), name="statistics"))
    sides: list[rrb.Container | rrb.View] = [rrb.Tabs(*tabs)] if tabs else []
    if layout.reported:
        sides.append(rrb.TextLogView(origin=paths.path(id, "log"), name="events", columns=_columns()))
    return rrb.Horizontal(*sides, column_shares=[1.5, 1.0][: len(sides)])


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


def _statistic(id: str, detector: str, outputs: int) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=paths.decision(id, detector),
        name=f"{detector}: statistic [no unit], threshold in red",
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
