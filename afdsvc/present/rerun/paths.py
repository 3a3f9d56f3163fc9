"""Where things stand in a Rerun file: entity paths, and columns of values over time."""

from __future__ import annotations

import colorsys
import re
import zlib

import numpy as np
import rerun as rr

from afdsvc.lti.statespace import Array

APPLICATION = "afdsvc"
SECONDS, CLOCK = "seconds", "utc"  # timelines: since the first sample of the review, and Unix time

# One view per group; the roles of the channels drawn in it, in this order.
GROUPS = {
    "outputs": ("y", "ref"),
    "inputs": ("u",),
    "excitation": ("alpha",),
    "residual": ("beta",),
    "whitened": ("r",),
    "aux": ("aux",),
}
TITLES = {
    "outputs": "output y",
    "inputs": "input u",
    "excitation": "excitation alpha",
    "residual": "residual beta",
    "whitened": "white r",
    "aux": "other signals",
}

GOLDEN_RATIO = 0.6180339887  # steps of it spread hues most evenly
LINES = ((86, 156, 255), (255, 142, 60), (90, 200, 130), (230, 100, 180), (160, 130, 255), (200, 200, 90))
FAINT = (170, 170, 170)
ZERO = (90, 90, 90)
THRESHOLD = (255, 70, 70)
ALARM = (255, 40, 40)
OPEN = (255, 120, 40)
DOUBT = (255, 190, 40)
QUIET = (96, 125, 139)
MEASURED = (255, 255, 255)
BURST = (255, 205, 80)
SHADE = (255, 205, 80, 10)


def path(machine: str, *parts: str) -> str:
    """Return an entity path; whatever characters an id or label has, it stays one part."""
    return "/" + "/".join(rr.escape_entity_path_part(part) for part in (machine, *parts))


def group(machine: str, name: str, *parts: str) -> str:
    """Return the path of a group of signals or of something drawn with them."""
    return path(machine, "signals", name, *parts)


def signal(machine: str, name: str, role: str, label: str) -> str:
    """Return the path of one signal."""
    return group(machine, name, f"{role}_{label}")


def shade(machine: str, name: str) -> str:
    """Return the path of a group's burst shading; signals lie over it, as the viewer goes by the alphabet."""
    return group(machine, name, "_burst")


def lane(machine: str, name: str) -> str:
    """Return the path of a lane of states; it is shown as it is, so what would have to be escaped becomes ``_``."""
    return path(machine, "states", re.sub(r"[^\w.-]", "_", name))


def fault_colour(fault: str) -> tuple[int, int, int]:
    """Return a fault's colour, the same in every view and every file: its hue follows from the name."""
    hue = zlib.adler32(fault.encode()) * GOLDEN_RATIO % 1
    red, green, blue = colorsys.hsv_to_rgb(hue, 0.6, 1.0)
    return round(255 * red), round(255 * green), round(255 * blue)


def plane(machine: str, number: int) -> str:
    """Return the path of a complex plane."""
    return path(machine, "planes", str(number))


def decision(machine: str, detector: str, *parts: str) -> str:
    """Return the path of a detector's statistics."""
    return path(machine, "decisions", detector, *parts)


class Columns:
    """Rows of one entity: times [Unix ns] and ``(n, width)`` values, sent together."""

    def __init__(self, entity: str, width: int) -> None:
        self.entity, self.width = entity, width
        self._times: list[np.ndarray] = []
        self._values: list[Array] = []

    def add(self, t_ns: np.ndarray, values: Array) -> None:
        """Append rows."""
        self._times.append(t_ns)
        self._values.append(values)

    def add_row(self, t_ns: int, *values: float) -> None:
        """Append one row."""
        self.add(np.array([t_ns]), np.array([values]))

    def send(self, recording: rr.RecordingStream, start_ns: int) -> None:
        """Send what was collected."""
        if not self._times:
            return
        t_ns, values = np.concatenate(self._times), np.concatenate(self._values)
        self._times, self._values = [], []
        scalars = rr.Scalars.columns(scalars=np.ascontiguousarray(values).reshape(-1))
        columns = scalars if self.width == 1 else scalars.partition(np.full(len(t_ns), self.width))
        recording.send_columns(self.entity, indexes=time_columns(t_ns, start_ns), columns=columns)


def time_columns(t_ns: np.ndarray, start_ns: int) -> list[rr.TimeColumn]:
    """Return Unix nanoseconds on both timelines."""
    seconds = (t_ns - start_ns).astype("timedelta64[ns]")
    return [rr.TimeColumn(SECONDS, duration=seconds), rr.TimeColumn(CLOCK, timestamp=t_ns.astype("datetime64[ns]"))]


def at(recording: rr.RecordingStream, t_ns: int, start_ns: int) -> None:
    """Set the time of what is logged next."""
    recording.set_time(SECONDS, duration=np.timedelta64(t_ns - start_ns, "ns"))
    recording.set_time(CLOCK, timestamp=np.datetime64(t_ns, "ns"))
