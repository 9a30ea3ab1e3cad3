"""RosSource: the `sensor_msgs/PointCloud2` messages of a topic, live from ROS 2 over Zenoh. No ROS is needed here.

It subscribes as a node with the middleware rmw_zenoh does (rmw_zenoh.py), at the router of ROS 2.

    ros2:/points                                      the topic, at the router on this machine
    ros2:/points?router=tcp/192.168.1.5:7447          at another one; `&domain=7` of another ROS_DOMAIN_ID,
                                                      `&distribution=humble` for ROS 2 Humble, whose keys have no hash
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from lidarcodec.bridges.rmw_zenoh import Node, Publisher, checked_topic
from lidarcodec.errors import SourceError
from lidarcodec.interop.ros import POINT_CLOUD2
from lidarcodec.packet import Packet
from lidarcodec.sensors.clouds.message import MAX_MESSAGE
from lidarcodec.sensors.clouds.sensor import cloud_sensor
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.cloud_packets import CloudPackets
from lidarcodec.sources.spec import Spec
from lidarcodec.transport import Endpoints, Transport, open_transport

ROUTER: Final = "tcp/127.0.0.1:7447"
WAITING: Final = 8
"""Messages that wait to be read; the oldest give way."""
TICK_S: Final = 0.2
FIRST_S: Final = 60.0
"""How long the first message is waited for, if the option `idle` does not say."""
HUMBLE: Final = "humble"


class RosSource(PacketSource):
    """Messages of one topic, each a packet, with the time of its header.

    Counts: `queue drops` (messages that nobody read in time), `too long` (of more than 32 MiB; they are not
    given), `no clouds` (other messages; they are given)
    """

    def __init__(
        self,
        topic: str,
        *,
        router: str = ROUTER,
        domain: int = 0,
        type_hashes: bool = True,
        idle_s: float | None = None,
        transport: Transport | None = None,
    ) -> None:
        """Subscribes, and waits for the first message, which says how many rows there are.

        idle_s: `packets` ends after this time without messages. transport: an open one, instead of the router
        Raises SettingsError for what is no topic or domain, TransportError, SourceError if nothing comes in time.
        """
        node = Node("lidarcodec", domain, "0", type_hashes)
        key = Publisher(node, 1, checked_topic(topic), POINT_CLOUD2).key
        self._own = transport is None
        self._transport = open_transport(Endpoints.of(connect=router)) if transport is None else transport
        self._queue: queue.Queue[bytes] = queue.Queue(WAITING)
        self._idle_s, self._dropped, self._too_long, self._ends = idle_s, 0, 0, False
        try:
            self._inbox = self._transport.inbox(key)
            self._thread = threading.Thread(target=self._receive, name=f"lidarcodec {topic}", daemon=True)
            self._thread.start()
            self._first = self._next(FIRST_S if idle_s is None else idle_s)
        except BaseException:
            self._close_transport()
            raise
        if self._first is None:
            self.closed = True
            self._inbox.close()
            self._close_transport()
            raise SourceError(
                f"no PointCloud2 arrived on {topic} from {router}: check the topic, domain {domain} and, for "
                "ROS 2 Humble, &distribution=humble"
            )
        super().__init__(cloud_sensor([self._first]), live=True)
        self.label = f"ROS 2 topic {topic}"

    @classmethod
    def from_spec(cls, spec: Spec, calibration: Path | None) -> RosSource:
        """The source for `ros2:/TOPIC?router=&domain=&distribution=&idle=`."""
        spec.only("router", "domain", "distribution", "idle", "model")
        topic = spec.place if spec.place.startswith("/") else f"/{spec.place}"
        distribution = spec.options.get("distribution", "")
        return cls(
            topic,
            router=spec.options.get("router", ROUTER),
            domain=spec.whole("domain", 0, 232) or 0,
            type_hashes=distribution.lower() != HUMBLE,
            idle_s=spec.number("idle", 0.001, 1e9),
        )

    def packets(self) -> Iterator[Packet]:
        """Messages as they come."""
        clouds = CloudPackets(self.counts)
        message, self._first = self._first, None
        while not self.closed:
            if message is None:
                message = self._next(self._idle_s)
            if message is None:
                return
            yield from clouds.of(message)
            message = None
            for cause, count in (("queue drops", self._dropped), ("too long", self._too_long)):
                if count:
                    self.counts[cause] = count

    def finish(self) -> None:
        """End: `packets` gives what has come by now, then ends."""
        self._ends = True

    def close(self) -> None:
        """Unsubscribe; harmless when called twice."""
        if not self.closed:
            self.closed = True
            self._inbox.close()
            self._close_transport()

    def _close_transport(self) -> None:
        if self._own:
            self._transport.close()

    def _receive(self) -> None:
        """In a thread of its own: messages from the network, which keeps one, into the queue."""
        while (message := self._inbox.receive()) is not None:
            if len(message) > MAX_MESSAGE:
                self._too_long += 1
                continue
            while True:
                try:
                    self._queue.put_nowait(message)
                    break
                except queue.Full:
                    try:
                        self._queue.get_nowait()
                        self._dropped += 1
                    except queue.Empty:
                        continue

    def _next(self, wait_s: float | None) -> bytes | None:
        """The next message; None if none came in time, or the source ended."""
        began = time.monotonic()
        while not getattr(self, "closed", False):
            try:
                return self._queue.get(timeout=0 if self._ends else TICK_S)
            except queue.Empty:
                if self._ends or (wait_s is not None and time.monotonic() - began >= wait_s):
                    return None
        return None
