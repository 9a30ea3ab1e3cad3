"""FoxgloveBridge: live streams for Foxglove, which connects to a WebSocket and shows cloud, poses and statistics.

    frame of a stream -> foxglove.PointCloud     -> /VEHICLE/SENSOR/points
    its pose, if any  -> foxglove.FrameTransform -> /VEHICLE/SENSOR/pose
    its mounting      -> foxglove.FrameTransform -> /VEHICLE/SENSOR/mount, once a second
    once a second     -> JSON                    -> /VEHICLE/SENSOR/statistics

Streams without viewers are not converted. If a viewer is slow, its oldest messages are dropped. Viewers connect through
a gate (gate.py), because Foxglove's server does not limit their number.
"""

from __future__ import annotations

import contextlib
import ipaddress
import json
import secrets
import socket
import threading
import time
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, Self

from lidarcodec.apps.ending import ended
from lidarcodec.bridges.gate import MAX_VIEWERS, Gate
from lidarcodec.bridges.origins import Origins
from lidarcodec.bridges.streams import Streams
from lidarcodec.bridges.viewer_log import ViewerLog
from lidarcodec.errors import MissingExtraError, TransportError
from lidarcodec.filling import filled
from lidarcodec.frame import Frame
from lidarcodec.interop import foxglove as messages
from lidarcodec.transport import Endpoints, Transport
from lidarcodec.transport.keys import StreamKeys

if TYPE_CHECKING:
    from foxglove import Channel
    from foxglove.websocket import WebSocketServer

HOST: Final = "127.0.0.1"
PORT: Final = 8765
INSIDE: Final = "127.0.0.1"
"""Address on which Foxglove's server listens for the gate if this machine has no other loopback address, as under
macOS."""
WAITING: Final = 4
"""Most messages of each stream that wait for one viewer: a cloud or two, a pose, statistics."""
ON_THE_WAY: Final = 2
"""Messages that Foxglove's server holds for a viewer beside those that wait."""
VIEWER_BYTES: Final = 32 * 2**20
"""Memory planned for a viewer and a stream. Where clouds are larger than that allows, there is room for fewer."""
LEAST_VIEWERS: Final = 2
EVERY_S: Final = 1.0

STATISTICS: Final = "lidarcodec.Statistics"
_NUMBER: Final = {"type": ["number", "null"]}
STATISTICS_SCHEMA: Final = {
    "type": "object",
    "title": STATISTICS,
    "properties": {
        "vehicle": {"type": "string"},
        "sensor": {"type": "string"},
        "alive": {"type": "boolean", "description": "whether the publisher is online"},
        "codec": {"type": ["string", "null"]},
        "kbps": {**_NUMBER, "description": "received since the previous statistics"},
        "target_kbps": {**_NUMBER, "description": "with target_kbps=auto: the bitrate that is used now"},
        "fps": {**_NUMBER, "description": "decoded frames a second"},
        "latency_ms": {**_NUMBER, "description": "from the last packet of a frame to the decoded frame, median"},
        "decode_ms": {**_NUMBER, "description": "median"},
        "points": {**_NUMBER, "description": "measured points in the last frame"},
        "made_up": {**_NUMBER, "description": "interpolated points between those; null while no viewer is connected"},
        "frames": {**_NUMBER, "description": "decoded since the start"},
        "replaced": {**_NUMBER, "description": "frames replaced by newer ones before they were encoded"},
        "missing": {**_NUMBER, "description": "frames that did not arrive, including replaced ones"},
        "skipped": {**_NUMBER, "description": "decoded frames replaced by newer ones before they were passed on"},
        "errors": {
            **_NUMBER,
            "description": "messages that could not be decoded, and frames that could not be passed on",
        },
    },
}


class _Channels:
    """The channels of one stream."""

    def __init__(self, key: StreamKeys, context: Any) -> None:
        from foxglove import Channel, Schema

        def channel(name: str, schema: messages.Schema) -> Channel:
            about = Schema(name=schema.name, encoding=messages.ENCODING, data=schema.data)
            topic = f"/{key.vehicle}/{key.sensor}/{name}"
            return Channel(topic, schema=about, message_encoding=messages.ENCODING, context=context)

        self.points = channel("points", messages.POINT_CLOUD)
        self.pose = channel("pose", messages.FRAME_TRANSFORM)
        self.mount = channel("mount", messages.FRAME_TRANSFORM)
        about = Schema(name=STATISTICS, encoding="jsonschema", data=json.dumps(STATISTICS_SCHEMA).encode())
        topic = f"/{key.vehicle}/{key.sensor}/statistics"
        self.statistics = Channel(topic, schema=about, message_encoding="json", context=context)
        self.frame_id = f"{key.vehicle}/{key.sensor}"
        self.returns: int | None = None
        self.made_up: int | None = None
        self.cloud_bytes = 0
        self.bytes = 0
        self.measured_s = time.monotonic()
        self._mounted_s = -EVERY_S

    def due(self) -> bool:
        """Whether the mounting was not said for a second: viewers come later, and Foxglove keeps none for them."""
        now_s = time.monotonic()
        if now_s - self._mounted_s < EVERY_S:
            return False
        self._mounted_s = now_s
        return True

    def close(self) -> None:
        """Remove the channels from all viewers."""
        for one in (self.points, self.pose, self.mount, self.statistics):
            one.close()


class FoxgloveBridge:
    """Serves streams until it is closed; a context manager.

    port: where it listens, once it is open;  counts: `clouds` and `transforms` given, `unwatched` frames,
    `second_returns_left_out` of clouds, `complaints` of the server about viewers: connections that broke, messages that
    were wrong
    gate: accepts viewers and counts them
    """

    def __init__(
        self,
        streams: Sequence[str],
        *,
        host: str = HOST,
        port: int = PORT,
        endpoints: Endpoints | None = None,
        transport: Transport | None = None,
        until_end: bool = False,
        fill: bool | None = None,
        max_viewers: int = MAX_VIEWERS,
        origins: Sequence[str] = (),
    ) -> None:
        """host, port: where to listen; port 0 takes a free one
        max_viewers: at once; half of them, rounded up, may be of one address
        origins: of web pages that may be viewers, beside those of Foxglove and of this machine

        fill: whether to interpolate returns between the columns of thinned frames, and mark them; None: except in
        streams with the purpose `localise` or `detect`
        Raises SettingsError, MissingExtraError.
        """
        try:
            import foxglove
        except ImportError:
            raise MissingExtraError("the bridge to Foxglove", "bridges") from None
        self._foxglove = foxglove
        self._streams = Streams(streams, self._take, endpoints=endpoints, transport=transport, until_end=until_end)
        self.host, self.port, self._fill = host, port, fill
        self.gate = Gate(host, port, max_viewers, Origins(origins).refusal)
        self.counts: Counter[str] = Counter()
        self._counting = threading.Lock()
        self._viewer_log = ViewerLog(lambda: self._count(complaints=1))
        self._context = foxglove.Context()
        self._channels: dict[StreamKeys, _Channels] = {}
        self._server: WebSocketServer | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._measure, name="bridge statistics", daemon=True)

    def __enter__(self) -> Self:
        """Listen, and begin to receive.

        Raises TransportError if nothing can listen there.
        """
        self.gate.listen()
        self._viewer_log.open()
        inside = _inside()
        try:
            self._server = self._foxglove.start_server(
                name="lidarcodec",
                host=inside,
                port=0,
                context=self._context,
                message_backlog_size=WAITING * len(self._streams.keys),
            )
        except (RuntimeError, OSError, ValueError) as error:
            self._viewer_log.close()
            self.gate.close()
            raise TransportError(f"the Foxglove server cannot listen on {inside}: {error}") from None
        self.port = self.gate.port
        self._channels = {key: _Channels(key, self._context) for key in self._streams.keys}
        self.gate.open((inside, self._server.port))
        self._streams.start()
        self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    @property
    def url(self) -> str:
        """The URL to open in Foxglove."""
        return f"ws://{self.host}:{self.port}"

    def wait(self, timeout_s: float) -> bool:
        """Wait until all streams have ended, at most `timeout_s`; returns whether they have.

        Raises the error that ended one.
        """
        return self._streams.wait(timeout_s)

    def interrupt(self) -> None:
        """Make `wait` return soon; for signal handlers."""
        self._streams.interrupt()

    def summary(self) -> dict[str, Any]:
        """Counts, where it listens, and how the streams are received."""
        return {**self.counts, **self.gate.counts, "url": self.url, "streams": self._streams.summary()}

    def close(self) -> None:
        """End everything, viewers' connections included; harmless when called twice."""
        self._stop.set()
        self.gate.close()  # first: the server waits for viewers that do not read
        self._streams.close()
        ended([self._thread])
        for channels in self._channels.values():
            channels.close()
        server, self._server = self._server, None
        if server is not None:
            server.stop()
        self._viewer_log.close()

    def _take(self, key: StreamKeys, frame: Frame) -> None:
        channels = self._channels[key]
        returns = int(frame.valid.sum())
        stamp = max(0, frame.stamp_ns)
        transforms = messages.transforms_of(frame, key.vehicle, channels.frame_id)
        for channel, transform in zip((channels.pose, channels.mount), transforms, strict=True):
            if transform is None or not channel.has_sinks() or (channel is channels.mount and not channels.due()):
                continue
            channel.log(transform, log_time=stamp)
            self._count(transforms=1)
        if not channels.points.has_sinks():
            channels.returns, channels.made_up = returns, None
            self._count(unwatched=1)
            return
        if self._streams.fills(key) if self._fill is None else self._fill:
            frame = filled(frame)
        channels.returns, channels.made_up = returns, int(frame.valid.sum()) - returns
        marks = self._fill is not False  # the same fields in each frame
        data = messages.point_cloud(frame, channels.frame_id, marks=marks)
        channels.cloud_bytes = len(data)
        self.gate.make_room(room(self.gate.most, [one.cloud_bytes for one in self._channels.values()]))
        channels.points.log(data, log_time=stamp)
        self._count(clouds=1, second_returns_left_out=self._streams.second_returns(key, frame))

    def _count(self, **numbers: int) -> None:
        with self._counting:
            self.counts.update(numbers)

    def _measure(self) -> None:
        while not self._stop.wait(EVERY_S):
            for key, channels in self._channels.items():
                if channels.statistics.has_sinks():
                    found = _statistics(key, self._streams, channels)
                    channels.statistics.log(json.dumps(found).encode(), log_time=time.time_ns())


def _inside() -> str:
    """A random loopback address: a web page that tries port after port does not find Foxglove's server."""
    address = str(ipaddress.IPv4Address((127 << 24) + 2 + secrets.randbelow((1 << 24) - 4)))
    with contextlib.suppress(OSError), socket.socket() as trial:
        trial.bind((address, 0))
        return address
    return INSIDE


def room(most: int, cloud_bytes: Sequence[int]) -> int:
    """How many viewers there is memory for. most: planned ones;  cloud_bytes: of each stream's newest cloud

    >>> room(16, [2_400_000]), room(16, [12_600_000]), room(16, [30_000_000])
    (16, 7, 2)
    """
    waiting = max(cloud_bytes) * (WAITING * len(cloud_bytes) + ON_THE_WAY)
    return max(LEAST_VIEWERS, min(most, most * VIEWER_BYTES * len(cloud_bytes) // max(waiting, 1)))


def _statistics(key: StreamKeys, streams: Streams, channels: _Channels) -> dict[str, Any]:
    """The current statistics, as STATISTICS_SCHEMA describes."""
    live = streams.live[key]
    here, there = streams.summary_of(key), live.status or {}
    now_s, received = time.monotonic(), here.get("bytes", 0)
    kbps = (received - channels.bytes) * 8e-3 / max(now_s - channels.measured_s, 1e-3)
    channels.bytes, channels.measured_s = received, now_s
    settings, rate = there.get("settings"), there.get("rate")
    codec = there.get("codec") or (settings.get("codec") if isinstance(settings, dict) else None)
    target = rate.get("target_kbps") if isinstance(rate, dict) else None
    replaced = there.get("replaced")
    return {
        "vehicle": key.vehicle,
        "sensor": key.sensor,
        "alive": live.alive,
        "codec": codec if isinstance(codec, str) else None,
        "kbps": round(kbps, 1),
        "target_kbps": target if isinstance(target, int | float) else None,
        "fps": here["fps"],
        "latency_ms": here["latency_ms"]["p50"],
        "decode_ms": here["decode_ms"]["p50"],
        "points": channels.returns,
        "made_up": channels.made_up,
        "frames": here.get("frames", 0),
        "replaced": replaced if isinstance(replaced, int | float) else None,
        "missing": here.get("missing", 0),
        "skipped": here["replaced"],
        "errors": sum(here["errors"].values()),
    }
