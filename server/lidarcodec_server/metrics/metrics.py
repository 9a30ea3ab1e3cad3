"""Metrics: Prometheus metrics of every stream and of the server. The number of labels is bounded by the streams.

Durations are in seconds, as Prometheus recommends. Counters keep their values when a publisher restarts.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

from prometheus_client import CollectorRegistry, Counter, Histogram, ProcessCollector, generate_latest
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector

from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.fleet.fleet import Fleet, Stream
from lidarcodec_server.metrics.spending import SPENDING, gauges_of
from lidarcodec_server.metrics.totals import Totals

MEDIA_TYPE = CONTENT_TYPE_PLAIN_0_0_4
LABELS = ["vehicle", "sensor"]
LARGEST = 2**63
METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS")
COUNTERS = {
    "frames": ("frames", "Frames sent."),
    "messages": ("messages", "Messages sent."),
    "bytes": ("bytes", "Bytes of messages sent."),
    "key_frames": ("key_frames", "Key messages sent."),
    "replaced_frames": ("replaced", "Frames replaced by a newer one before they were encoded."),
    "no_receiver_frames": ("no_receiver", "Frames that were not encoded because no receiver was connected."),
    "left_out_frames": ("left_out", "Frames that were left out to keep the target bitrate."),
    "encode_errors": ("encode errors", "Frames that could not be encoded."),
    "put_errors": ("put errors", "Messages that could not be sent."),
    "publisher_restarts": ("restarts", "Starts of the publisher after the first that the server knows of."),
    "lost_packets": ("lost packets", "Packets of the sensor that are missing by its own clock."),
    "kernel_drops": ("kernel drops", "Packets of the sensor that the vehicle's kernel dropped."),
    "queue_drops": ("queue drops", "Packets of the sensor that the publisher dropped from a full queue."),
    "unrecorded_frames": ("recording unstored", "Frames or batches of packets that the vehicle did not record."),
    "unkept_frames": ("past unstored", "Frames that the vehicle did not keep."),
    "received_frames": ("received frames", "Frames decoded by all receivers together."),
    "missing_frames": (
        "received missing",
        "Frames missing at receivers: replaced by the publisher, or lost.",
    ),
    "decode_errors": ("received decode_errors", "Messages that receivers could not decode."),
    "missing_references": ("received missing_references", "Messages that arrived without the frame that they need."),
}
"""For each metric: its name in Totals, and its help text."""
HISTOGRAMS = {
    "encode": "Time to encode a frame.",
    "put": "Time to hand a message to the network.",
    "decode": "Time to decode a message, at receivers.",
    "latency": "From the host time of a frame's last packet to the decoded frame, at receivers.",
}
STOPPED = {
    "recording": "1 while the vehicle does not record any more.",
    "past": "1 while the vehicle does not keep any more.",
}
GAUGES = {"fps": "Frames sent a second.", "kbps": "Kilobits sent a second."}


class Metrics:
    """Collects and reports the metrics. Thread-safe. Other parts add theirs to `registry`."""

    def __init__(self, fleet: Fleet, ready: Callable[[], dict[str, bool]] = dict) -> None:
        """ready: gives for each part of the server whether it is ready"""
        self.registry = CollectorRegistry()
        self._ready = ready
        self.registry.register(_Streams(self))
        ProcessCollector(registry=self.registry)
        self._fleet = fleet
        self._lock = threading.Lock()
        self._totals: dict[StreamKeys, Totals] = {}
        self._requests = Counter(
            "lidarcodec_http_requests", "Requests.", ["method", "route", "status"], registry=self.registry
        )
        self._seconds = Histogram(
            "lidarcodec_http_request_seconds", "Time to answer a request.", ["route"], registry=self.registry
        )
        self._refused = Counter(
            "lidarcodec_auth_failures", "Requests without a valid token.", ["reason"], registry=self.registry
        )

    def told(self, keys: StreamKeys) -> None:
        """A status of the stream arrived."""
        stream = self._fleet.get(keys)
        if stream is None or stream.status is None:
            return
        with self._lock:
            self._totals.setdefault(keys, Totals()).status(stream.status)
            if len(self._totals) > len(self._fleet.streams()):
                known = {one.keys for one in self._fleet.streams()}
                self._totals = {one: totals for one, totals in self._totals.items() if one in known}

    def request(self, method: str, route: str, status: int, seconds: float) -> None:
        """A request was answered. route: the pattern of its path, so that the number of labels stays small"""
        self._requests.labels(method if method in METHODS else "other", route, status).inc()
        self._seconds.labels(route).observe(seconds)

    def refused(self, reason: str) -> None:
        """A client was refused. reason: its token was `missing` or `wrong`, or its `role` did not permit the request"""
        self._refused.labels(reason).inc()

    def text(self) -> bytes:
        """All metrics in Prometheus' text format."""
        return generate_latest(self.registry)

    def streams(self) -> tuple[list[Stream], dict[StreamKeys, Totals]]:
        """Streams and their totals."""
        with self._lock:
            return self._fleet.streams(), dict(self._totals)

    def collected(self) -> Iterator[Metric]:
        """The metrics of the streams."""
        streams, totals = self.streams()
        alive = GaugeMetricFamily("lidarcodec_stream_alive", "Whether the publisher is online.", labels=LABELS)
        codec = GaugeMetricFamily("lidarcodec_stream_codec", "1 for the codec in force.", labels=[*LABELS, "codec"])
        for stream in streams:
            labels = [stream.keys.vehicle, stream.keys.sensor]
            alive.add_metric(labels, float(stream.alive))
            if stream.alive and stream.codec is not None:
                codec.add_metric([*labels, stream.codec[:32]], 1.0)
        yield alive
        yield codec
        for name, text in GAUGES.items():
            gauge = GaugeMetricFamily(f"lidarcodec_stream_{name}", text, labels=LABELS)
            for stream in streams:
                value = (stream.status or {}).get(name)
                # A larger number may not fit a float.
                if stream.alive and isinstance(value, int | float) and abs(value) < LARGEST:
                    gauge.add_metric([stream.keys.vehicle, stream.keys.sensor], float(value))
            yield gauge
        yield from _spent(streams)
        yield from _stopped(streams)
        yield from _counted(streams, totals)
        ready = GaugeMetricFamily("lidarcodec_ready", "Whether a part of the server answers.", labels=["part"])
        for part, answers in self._ready().items():
            ready.add_metric([part], float(answers))
        yield ready
        fleet = self._fleet
        left_out, by_vehicle = fleet.left_out()
        of_vehicles = CounterMetricFamily(
            "lidarcodec_vehicle_streams_left_out",
            "Streams that were refused because all places were taken, by vehicle.",
            labels=["vehicle"],
        )
        for vehicle, times in by_vehicle.items():
            of_vehicles.add_metric([vehicle], times)
        yield of_vehicles
        for name, text, value in (
            ("streams_left_out", "Streams that were refused because all places were taken.", left_out),
            ("statuses_refused", "Statuses that are not JSON, or beyond its limits.", fleet.refused),
            ("status_fields_dropped", "Fields of statuses that are unknown, or of a wrong type.", fleet.dropped),
        ):
            yield CounterMetricFamily(f"lidarcodec_{name}", text, value=value)


def _spent(streams: list[Stream]) -> Iterator[Metric]:
    told = [
        ([one.keys.vehicle, one.keys.sensor], gauges_of(one.status, one.settings, one.codec))
        for one in streams
        if one.alive and one.status is not None
    ]
    for name, text in SPENDING.items():
        gauge = GaugeMetricFamily(f"lidarcodec_stream_{name}", text, labels=LABELS)
        for labels, values in told:
            if name in values:
                gauge.add_metric(labels, values[name])
        yield gauge


def _stopped(streams: list[Stream]) -> Iterator[Metric]:
    for name, text in STOPPED.items():
        gauge = GaugeMetricFamily(f"lidarcodec_stream_{name}_stopped", text, labels=LABELS)
        for stream in streams:
            state = (stream.status or {}).get(name)
            if stream.alive and isinstance(state, dict):
                gauge.add_metric([stream.keys.vehicle, stream.keys.sensor], float(state.get("stopped") is not None))
        yield gauge


def _counted(streams: list[Stream], totals: dict[StreamKeys, Totals]) -> Iterator[Metric]:
    known = [(totals[one.keys], [one.keys.vehicle, one.keys.sensor]) for one in streams if one.keys in totals]
    for name, (field, text) in COUNTERS.items():
        counter = CounterMetricFamily(f"lidarcodec_{name}", text, labels=LABELS)
        for total, labels in known:
            counter.add_metric(labels, total[field])
        yield counter
    for name, text in HISTOGRAMS.items():
        histogram = HistogramMetricFamily(f"lidarcodec_{name}_seconds", text, labels=LABELS)
        for total, labels in known:
            histogram.add_metric(labels, *total.histogram(name))
        yield histogram


class _Streams(Collector):
    """Metrics that are computed at each request."""

    def __init__(self, metrics: Metrics) -> None:
        self._metrics = metrics

    def collect(self) -> Iterator[Metric]:
        return self._metrics.collected()

    def describe(self) -> list[Metric]:
        return []
