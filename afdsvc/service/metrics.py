"""Metrics for Prometheus, read from the service's status on request."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from afdsvc.errors import BadInput
from afdsvc.service.http_server import serve_http
from afdsvc.wire.messages import AlarmKind, MachineStatus, ServiceStatus

Row = tuple[str, str, Callable[[MachineStatus], float]]
GAUGES: tuple[Row, ...] = (
    ("machine_up", "1 while the machine is connected and sends samples", lambda m: float(m.state == "running")),
    ("machine_trustworthy", "1 while decisions about the machine can be trusted", lambda m: float(m.trustworthy)),
    ("block_age_seconds", "age of the newest block of samples", lambda m: m.block_age),
    ("head_room_ratio", "share of the sample period not used by the control loop", lambda m: m.head_room),
    ("burst_playing", "1 while a burst plays", lambda m: float(bool(m.burst))),
)
COUNTERS: tuple[Row, ...] = (
    ("blocks", "blocks of samples received", lambda m: m.blocks),
    ("lost_samples", "samples that never came", lambda m: m.lost_blocks),
    ("late_samples", "samples the rig computed too late", lambda m: m.late),
)


class Collector:
    """What prometheus-client asks on every scrape."""

    def __init__(self, status: Callable[[], ServiceStatus]) -> None:
        self._status = status

    def collect(self) -> Iterable[Any]:
        """Yield the metric families."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        status = self._status()
        for kind, rows in ((GaugeMetricFamily, GAUGES), (CounterMetricFamily, COUNTERS)):
            for name, what, value in rows:
                family = kind(f"afdsvc_{name}", what, labels=["machine"])
                for m in status.machines:
                    family.add_metric([m.machine], value(m))
                yield family
        yield self._alarms(status, GaugeMetricFamily)
        waits = GaugeMetricFamily("afdsvc_longest_wait_seconds", "longest wait of the last 10 to 20 minutes", labels=["of"])
        for what, wait in status.longest_waits.items():
            waits.add_metric([what], wait)
        yield waits
        yield GaugeMetricFamily("afdsvc_uptime_seconds", "time since the service started", value=status.uptime)
        yield CounterMetricFamily("afdsvc_recording_bytes", "bytes written", value=status.recording_bytes)
        yield CounterMetricFamily("afdsvc_dropped_messages", "messages dropped", value=status.recording_dropped)
        yield GaugeMetricFamily("afdsvc_recording_failing", "1 while nothing is recorded", value=bool(status.recording_failure))

    @staticmethod
    def _alarms(status: ServiceStatus, kind: Any) -> Any:
        family = kind("afdsvc_alarms", "alarms that hold", labels=["machine", "kind", "acknowledged"])
        for m in status.machines:
            for which in AlarmKind:
                for seen in (False, True):
                    held = sum(a.active and a.kind is which and a.acknowledged is seen for a in m.alarms)
                    family.add_metric([m.machine, which.value, str(seen).lower()], held)
        return family


def serve_metrics(listen: str, status: Callable[[], ServiceStatus]) -> Callable[[], None]:
    """Serve ``/metrics`` at ``host:port`` in a thread; returns what stops it.

    Raises `BadInput` when the address is taken or the extra is not installed.
    """
    try:
        from prometheus_client import CollectorRegistry, MetricsHandler
    except ImportError:
        raise BadInput("metrics.listen needs the extra 'metrics': install afdsvc[metrics]") from None
    registry = CollectorRegistry(auto_describe=False)
    registry.register(Collector(status))
    return serve_http("metrics.listen", listen, MetricsHandler.factory(registry))
