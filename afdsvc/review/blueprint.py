"""The layout made for this work: one tab per machine; left the signals, right what was decided about them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import rerun.blueprint as rrb

from afdsvc.review import paths


@dataclass(frozen=True, slots=True)
class MachineLayout:
    """What there is to show of one machine: groups of signals with their common unit, and detectors."""

    groups: Mapping[str, str]
    detectors: Sequence[str]


def blueprint(machines: Mapping[str, MachineLayout]) -> rrb.Blueprint:
    """Return the layout of all machines, the whole time range shown."""
    tabs = [_machine(id, layout) for id, layout in machines.items()]
    return rrb.Blueprint(
        rrb.Tabs(*tabs) if len(tabs) > 1 else tabs[0],
        rrb.TimePanel(state="collapsed", timeline=paths.SECONDS),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )


def _machine(id: str, layout: MachineLayout) -> rrb.Container:
    signals = [_signals(id, name, unit) for name, unit in layout.groups.items()]
    statistics = [_statistic(id, detector) for detector in layout.detectors]
    # A lane is a few lines high however many there are; the log takes a little more.
    states = rrb.StateTimelineView(
        origin=paths.path(id, "states"), name="bursts and decisions", time_view=whole_range()
    )
    log = rrb.TextLogView(origin=paths.path(id, "log"), name="events")
    right = rrb.Vertical(*statistics, states, log, row_shares=[3.0] * len(statistics) + [3.0, 2.5])
    if not signals:
        return rrb.Horizontal(right, name=id)
    return rrb.Horizontal(rrb.Vertical(*signals), right, name=id, column_shares=[1.15, 1.0])


def _signals(id: str, name: str, unit: str) -> rrb.TimeSeriesView:
    title = paths.TITLES[name] + (f" [{unit}]" if unit else "")
    return rrb.TimeSeriesView(origin=paths.group(id, name), name=title, axis_x=whole_range(), plot_legend=_legend())


def _statistic(id: str, detector: str) -> rrb.TimeSeriesView:
    title = f"{detector}: statistic against threshold"
    return rrb.TimeSeriesView(
        origin=paths.decision(id, detector), name=title, axis_x=whole_range(), plot_legend=_legend()
    )


def _legend() -> rrb.PlotLegend:
    return rrb.PlotLegend(rrb.Corner2D.LeftTop)


def whole_range() -> rrb.TimeAxis:
    """Return an axis that shows everything; by default the viewer opens long recordings at their end."""
    edge = rrb.TimeRangeBoundary.infinite()
    return rrb.TimeAxis(view_range=rrb.TimeRange(start=edge, end=edge))
