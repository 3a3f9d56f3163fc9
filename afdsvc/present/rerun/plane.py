"""The complex plane of a burst: fault curves and the measured phasors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr

from afdsvc.lti.statespace import Array
from afdsvc.present.rerun import paths
from afdsvc.present.rerun.paths import at

SEEN = 0.05  # share of the plane below which a curve is a dot at the origin


@dataclass(frozen=True, slots=True, eq=False)
class PhasorPoint:
    """What one burst answered on one line and output, as (real, imaginary) in standard deviations of its noise."""

    t_ns: int
    burst: str
    value: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """One excited line seen at one output: ``curves`` are ``(severities, 2)`` by fault, from 0 to the severity in ``ends``.

    Coordinates are those of the whitened residual on the line, in standard deviations of its noise over a whole burst.
    """

    title: str
    curves: Mapping[str, Array]
    ends: Mapping[str, float]
    points: Sequence[PhasorPoint]


def log_planes(recording: rr.RecordingStream, machine: str, planes: Sequence[Plane], start_ns: int) -> None:
    """Log the planes of a machine: curves for ever, points when they were measured."""
    for number, plane in enumerate(planes):
        root, radius = paths.plane(machine, number), 0.02 * half_width(plane)
        _curves(recording, root, plane)
        _axes(recording, root, plane)
        for point in plane.points:
            at(recording, point.t_ns, start_ns)
            for name, size, colour, order in (("measured", 1.5, paths.MEASURED, 20.0), (f"trail/{point.t_ns}", 1.0, paths.FAINT, 10.0)):
                dot = rr.Points2D([_up(point.value)], radii=[size * radius], colors=[colour], draw_order=order)
                recording.log(f"{root}/{name}", dot)
        recording.reset_time()


def _curves(recording: rr.RecordingStream, root: str, plane: Plane) -> None:
    size = half_width(plane)
    for number, (fault, curve) in enumerate(plane.curves.items()):
        colour, end = paths.fault_colour(fault), plane.ends[fault]
        recording.log(f"{root}/curves/{fault}", rr.LineStrips2D([[_up(p) for p in curve]], colors=[colour], radii=[0.006 * size]), static=True)
        if np.abs(curve).max() < SEEN * size:
            continue  # this line and output hardly show it
        # Curves may lie on one another: each is named at a place of its own.
        i = len(curve) * (4 - number % 4) // 4 - 1
        label = rr.Points2D([_up(curve[i])], labels=[f"{fault} {100 * end * i / (len(curve) - 1):.0f} %"], radii=[0.012 * size], colors=[colour], show_labels=True)
        recording.log(f"{root}/ends/{fault}", label, static=True)


def _axes(recording: rr.RecordingStream, root: str, plane: Plane) -> None:
    size = half_width(plane)
    axes = [[[-size, 0.0], [size, 0.0]], [[0.0, -size], [0.0, size]]]
    recording.log(f"{root}/axes", rr.LineStrips2D(axes, colors=[paths.ZERO], radii=[0.002 * size], draw_order=-10.0), static=True)
    # Their length shows in the quarter that no curve lies in.
    side = np.where(sum(c.sum(axis=0) for c in plane.curves.values()) > 0, -1.0, 1.0) if plane.curves else np.ones(2)
    scale = rr.Points2D([_up(0.75 * size * side)], labels=[f"axes to ±{float(format(size, '.2g')):g}"], radii=[0.0], colors=[paths.FAINT], show_labels=True)
    recording.log(f"{root}/scale", scale, static=True)


def _up(value: Sequence[float] | Array) -> tuple[float, float]:
    """Return a point as the viewer wants it: its second axis points down."""
    return float(value[0]), -float(value[1])


def half_width(plane: Plane) -> float:
    """Return half the width of a plane: everything lies inside."""
    found = [np.abs(c).max() for c in plane.curves.values()] + [max(map(abs, p.value)) for p in plane.points]
    return 1.1 * float(max(found, default=1.0))
