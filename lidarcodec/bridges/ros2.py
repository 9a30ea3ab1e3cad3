"""RosBridge: live streams as `sensor_msgs/PointCloud2` for ROS 2, straight into its Zenoh network; no ROS needed here.

    frame of a stream -> PointCloud2 in CDR    -> topic /VEHICLE/SENSOR/points
    its message       -> CompressedPointCloud2 -> topic /VEHICLE/SENSOR/points/lidarcodec
    its pose, if any  -> TFMessage             -> topic /tf
    its mounting      -> TFMessage             -> topic /tf_static, once a second

Nothing is made while nobody subscribes. A frame that comes while one is being sent replaces the one that waits.
Messages are passed on as they come, every one of them: most build on those before.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

from lidarcodec.bridges.rmw_zenoh import Node, Publisher, checked_topic, topic_name
from lidarcodec.bridges.streams import Streams
from lidarcodec.errors import SettingsError, TransportError
from lidarcodec.filling import filled
from lidarcodec.frame import Frame
from lidarcodec.interop.compressed_cloud import coded_topic, compressed_cloud
from lidarcodec.interop.point_cloud2 import frame_of_points, point_cloud2, tf_message
from lidarcodec.interop.ros import COMPRESSED_CLOUD, POINT_CLOUD2, TF_MESSAGE
from lidarcodec.mounting import vehicle_pose
from lidarcodec.transport import Endpoints, Transport, open_transport
from lidarcodec.transport.base import Closeable, Priority, Sender
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.wire import peek

logger = logging.getLogger(__name__)

ROUTER: Final = "tcp/127.0.0.1:7447"
"""Where the router of ROS 2 (rmw_zenohd) listens unless it is told otherwise."""
NODE: Final = "lidarcodec_bridge"
WORLD: Final = "map"
TF_TOPIC: Final = "/tf"
STATIC_TF_TOPIC: Final = "/tf_static"
STATIC_S: Final = 1.0
"""How often a mounting is sent again: nothing here keeps messages for listeners that come later."""
TF_DEPTH: Final = 100
CODED_DEPTH: Final = 10
"""Messages kept for a slow node: it needs all of them."""


@dataclass(frozen=True)
class RosNames:
    """What things are called in ROS.

    topic, frame_id: of the one stream that there is; by default `/VEHICLE/SENSOR/points` and `VEHICLE/SENSOR`
    world: the frame in which poses are given;  transforms: whether they and mountings are published
    domain: ROS_DOMAIN_ID
    type_hashes: False for ROS 2 Humble, which knows none
    """

    topic: str | None = None
    frame_id: str | None = None
    world: str = WORLD
    transforms: bool = True
    domain: int = 0
    type_hashes: bool = True

    def topic_of(self, keys: StreamKeys) -> str:
        """Of a stream's points."""
        return checked_topic(self.topic or topic_name(keys.vehicle, keys.sensor, "points"))

    def vehicle_of(self, keys: StreamKeys) -> str:
        """Name of the frame of a stream's vehicle."""
        return f"{keys.vehicle}/base_link"

    def frame_of(self, keys: StreamKeys) -> str:
        """Of a stream's points, and the child of its transforms."""
        return self.frame_id or f"{keys.vehicle}/{keys.sensor}"


class _Topic:
    """A publisher of ROS, once the network is open. Thread-safe."""

    def __init__(self, publisher: Publisher, transport: Transport, priority: Priority = Priority.FRAMES) -> None:
        """Raises MissingExtraError, before anything is declared, and TransportError."""
        self._publisher, self._lock, self._number = publisher, threading.Lock(), 0
        publisher.attachment(0, 0)
        self._sender: Sender = transport.sender(publisher.key, priority)
        self._token: Closeable = transport.token(publisher.token)

    @property
    def wanted(self) -> bool:
        """Whether anybody subscribes."""
        return self._sender.matching

    def put(self, data: bytes) -> None:
        with self._lock:
            self._number += 1
            self._sender.put(data, self._publisher.attachment(self._number, time.time_ns()))

    def close(self) -> None:
        """Go: the token first, so that nobody waits for more."""
        self._token.close()
        self._sender.close()


class RosBridge:
    """Bridges streams until it is closed; a context manager.

    counts: `clouds`, `points` (measured), `made_up` points, `transforms`, `mountings` and `coded` messages sent, and
    `unwatched` frames, to whose points nobody subscribed, and `second_returns_left_out` of clouds
    """

    def __init__(
        self,
        streams: Sequence[str],
        names: RosNames | None = None,
        *,
        endpoints: Endpoints | None = None,
        ros: Endpoints | None = None,
        transport: Transport | None = None,
        ros_transport: Transport | None = None,
        until_end: bool = False,
        fill: bool = False,
    ) -> None:
        """endpoints: where the streams are;  ros: where the router of ROS 2 is; transports: open ones instead.

        fill: whether returns are made up between the columns of thinned frames, and marked. Most programs of ROS take
        every point for a measured one.

        Raises SettingsError for names that cannot be used.
        """
        self.names = names or RosNames()
        self.counts: Counter[str] = Counter()
        self._fill, self._told_frame = fill, False
        self._streams = Streams(
            streams,
            self._take,
            endpoints=endpoints,
            transport=transport,
            until_end=until_end,
            take_message=self._take_message,
        )
        if len(self._streams.keys) > 1 and (self.names.topic or self.names.frame_id):
            raise SettingsError("--topic and --frame-id work with a single stream only", "topic")
        self.topics = {key: self.names.topic_of(key) for key in self._streams.keys}
        if len(set(self.topics.values())) < len(self.topics):
            raise SettingsError(
                "two streams have the same topic: bridge one of them with a separate command and its own --topic",
                "topic",
            )
        Node(NODE, self.names.domain, "")  # an invalid name raises now
        self._ros_endpoints = ros or Endpoints.of(connect=ROUTER)
        self._given_transport, self._transport = ros_transport, ros_transport
        self._stop = threading.Event()
        self._interrupted = False
        self._points: dict[StreamKeys, _Topic] = {}
        self._coded: dict[StreamKeys, _Topic] = {}
        self._followed: set[StreamKeys] = set()
        self._tf: _Topic | None = None
        self._static: _Topic | None = None
        self._mounted_s: dict[StreamKeys, float] = {}
        self._node: Closeable | None = None
        self._counting = threading.Lock()

    def __enter__(self) -> Self:
        """Open the network of ROS 2, whose router may come later, and begin; nothing begins where that is interrupted.

        Raises TransportError, MissingExtraError.
        """
        try:
            self._open()
        except BaseException as error:
            self.close()
            if isinstance(error, TransportError) and self._interrupted:
                return self
            raise
        self._streams.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def wait(self, timeout_s: float) -> bool:
        """Whether all streams have ended; waits for it, at most `timeout_s`. Raises what ended them."""
        return self._streams.wait(timeout_s)

    def interrupt(self) -> None:
        """Have it end soon; for signal handlers."""
        self._interrupted = True
        self._stop.set()
        self._streams.interrupt()

    def summary(self) -> dict[str, Any]:
        """Counts, topics, and how the streams are received."""
        topics = {f"{key.vehicle}/{key.sensor}": topic for key, topic in self.topics.items()}
        return {**self.counts, "topics": topics, "streams": self._streams.summary()}

    def close(self) -> None:
        """End everything: tokens go, so that ROS sees the publishers go. Harmless when called twice."""
        self._stop.set()
        self._streams.close()
        own = self._transport if self._given_transport is None else None
        for one in (*self._points.values(), *self._coded.values(), self._tf, self._static, self._node, own):
            if one is not None:
                one.close()

    def _open(self) -> None:
        if self._transport is None:
            self._transport = open_transport(self._ros_endpoints, stop=self._stop)
        node = Node(NODE, self.names.domain, self._transport.identity, self.names.type_hashes)
        self._node = self._transport.token(node.token)
        for number, (key, topic) in enumerate(self.topics.items(), 1):
            self._points[key] = _Topic(Publisher(node, number, topic, POINT_CLOUD2), self._transport)
            coded = Publisher(node, len(self.topics) + number, coded_topic(topic), COMPRESSED_CLOUD, CODED_DEPTH)
            self._coded[key] = _Topic(coded, self._transport)
        if self.names.transforms:
            number = 2 * len(self.topics) + 1
            tf = Publisher(node, number, TF_TOPIC, TF_MESSAGE, TF_DEPTH)
            # Past clouds that wait for a slow network: behind one of those it would be thrown away.
            self._tf = _Topic(tf, self._transport, Priority.REAL_TIME)
            static = Publisher(node, number + 1, STATIC_TF_TOPIC, TF_MESSAGE, TF_DEPTH)
            self._static = _Topic(static, self._transport, Priority.REAL_TIME)

    def _take(self, key: StreamKeys, frame: Frame) -> None:
        topic, frame_id = self._points[key], self._frame_of_points(key, frame)
        self._transform(key, frame, frame_id)
        if not topic.wanted:
            self._count(unwatched=1)
            return
        points = int(frame.valid.sum())
        if self._fill:
            frame = filled(frame)
        topic.put(point_cloud2(frame, frame_id, marks=self._fill))
        self._count(
            clouds=1,
            points=points,
            made_up=int(frame.valid.sum()) - points,
            second_returns_left_out=self._streams.second_returns(key, frame),
        )

    def _frame_of_points(self, key: StreamKeys, frame: Frame) -> str:
        """A point cloud has its own; coded messages are in the one of the stream."""
        name = frame_of_points(frame, self.names.frame_of(key))
        if self.names.frame_id not in (None, name) and not self._told_frame:
            self._told_frame = True
            logger.warning("--frame-id is for coded messages only: point clouds stay as they are, in frame %s", name)
        return name

    def _transform(self, key: StreamKeys, frame: Frame, frame_id: str) -> None:
        """Publish the pose of a frame, and its mounting if that was not said for a second: for the frame of the points,
        and for that of coded messages."""
        mount, vehicle, now_s = frame.mount, self.names.vehicle_of(key), time.monotonic()
        sensors = dict.fromkeys((frame_id, self.names.frame_of(key)))
        if self._tf is not None and frame.pose is not None and self._tf.wanted:
            for child in sensors if mount is None else (vehicle,):
                self._tf.put(tf_message(frame.stamp_ns, self.names.world, child, vehicle_pose(frame.pose, mount)))
            self._count(transforms=1)
        if self._static is None or mount is None or not self._static.wanted:
            return
        if now_s - self._mounted_s.get(key, -STATIC_S) >= STATIC_S:
            self._mounted_s[key] = now_s
            for child in sensors:
                self._static.put(tf_message(frame.stamp_ns, vehicle, child, mount))
            self._count(mountings=1)

    def _take_message(self, key: StreamKeys, data: bytes) -> None:
        topic = self._coded[key]
        if not topic.wanted:
            self._followed.discard(key)
            return
        header = peek(data)
        if key not in self._followed:  # a node that comes between two key messages does not wait for the next one
            self._followed.add(key)
            if not header.key:
                self._streams.live[key].request_key()
        topic.put(compressed_cloud(data, header.stamp_ns, self.names.frame_of(key)))
        self._count(coded=1)

    def _count(self, **numbers: int) -> None:
        with self._counting:
            self.counts.update(numbers)
