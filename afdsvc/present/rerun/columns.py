"""Numbers collected for the viewer, so that one call carries many: each call costs 0.3 ms."""

from __future__ import annotations

import numpy as np
import rerun as rr

from afdsvc.lti.statespace import Array
from afdsvc.present.rerun.paths import CLOCK, SECONDS


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
