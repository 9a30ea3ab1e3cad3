"""What the gate in front of the server's own TLS port does."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

GAUGES: Final = {
    "open": "Connections with a session.",
    "unfinished": "Connections without a session yet.",
    "barred": "Addresses that are barred.",
    "running": "Whether the process of the gate runs.",
}
COUNTERS: Final = {
    "sessions": "Connections that got a session.",
    "failed": "Handshakes that failed.",
    "restarts": "Times that the process of the gate was started again.",
}


class GateMetrics(Collector):
    """Nothing without a gate."""

    def __init__(self, gate: Callable[[], dict[str, Any] | None]) -> None:
        self._gate = gate

    def collect(self) -> Iterator[Metric]:
        """Now."""
        state = self._gate()
        if state is None:
            return
        for name, text in GAUGES.items():
            yield GaugeMetricFamily(f"lidarcodec_gate_{name}", text, value=float(state.get(name, 0)))
        for name, text in COUNTERS.items():
            yield CounterMetricFamily(f"lidarcodec_gate_{name}", text, value=float(state.get(name, 0)))
        refused = CounterMetricFamily("lidarcodec_gate_refused", "Connections that were refused.", labels=["cause"])
        for cause, times in state.get("refused", {}).items():
            refused.add_metric([cause], times)
        yield refused
