"""Prometheus metrics of viewers and recordings. The number of labels is bounded by the number of viewed streams."""

from __future__ import annotations

from collections.abc import Iterator

from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from lidarcodec_server.live.hub import LiveHub
from lidarcodec_server.live.recordings import ENDS, Recordings
from lidarcodec_server.live.viewer import CloudViewer, FramesViewer

KINDS = (CloudViewer.kind, FramesViewer.kind)
COUNTERS = {
    "sent": "Frames or messages sent to viewers.",
    "skipped": "Frames or messages replaced by newer ones, because the viewer had not acknowledged the last.",
    "sent_bytes": "Bytes sent to viewers.",
}
REASONS = ("slow", "abuse", "revoked", "gave way", "failed")


class LiveMetrics(Collector):
    """Collects current values at each request, in any thread."""

    def __init__(self, hub: LiveHub, recordings: Recordings) -> None:
        self._hub, self._recordings = hub, recordings

    def describe(self) -> list[Metric]:
        """No metric: their names are not checked beforehand."""
        return []

    def collect(self) -> Iterator[Metric]:
        """The current metrics."""
        viewers = GaugeMetricFamily("lidarcodec_viewers", "Live sockets.", labels=["vehicle", "sensor", "kind"])
        totals = dict(self._hub.counts)
        for keys, watch in self._hub.watches().items():
            looking = list(watch.viewers)
            for kind in KINDS:
                viewers.add_metric([keys.vehicle, keys.sensor, kind], sum(one.kind == kind for one in looking))
            for one in looking:
                for name in COUNTERS:
                    totals[f"{one.kind} {name}"] = totals.get(f"{one.kind} {name}", 0) + getattr(one, name)
        yield viewers
        for name, text in COUNTERS.items():
            counter = CounterMetricFamily(f"lidarcodec_viewer_{name}", text, labels=["kind"])
            for kind in KINDS:
                counter.add_metric([kind], totals.get(f"{kind} {name}", 0))
            yield counter
        refused = totals.get("refused", 0)
        yield CounterMetricFamily(
            "lidarcodec_viewers_refused", "Viewers that were refused because all places were taken.", value=refused
        )
        ended = CounterMetricFamily("lidarcodec_viewers_ended", "Viewers that were disconnected.", labels=["reason"])
        for reason in REASONS:
            ended.add_metric([reason], totals.get(reason, 0))
        yield ended
        pack = self._hub.pack_ms.summary()
        for q in ("p50", "p99"):
            seconds = None if pack[q] is None else pack[q] / 1e3
            text = f"Time to prepare a frame for viewers, {q} of the newest 600."
            if seconds is not None:
                yield GaugeMetricFamily(f"lidarcodec_viewer_pack_{q}_seconds", text, value=seconds)
        yield GaugeMetricFamily("lidarcodec_recordings_running", "Recordings.", value=self._recordings.running)
        ends = CounterMetricFamily("lidarcodec_recordings_ended", "Recordings that ended.", labels=["reason"])
        for reason in ENDS:
            ends.add_metric([reason], self._recordings.ends[reason])
        yield ends
        yield GaugeMetricFamily("lidarcodec_playbacks_running", "Playbacks.", value=self._recordings.played)
