"""RosbagWriter: packets as `velodyne_msgs/VelodyneScan` in a rosbag2 of MCAP format, optionally with points.

`ros2 bag play` plays the bag, and the Velodyne driver converts its packets to points. A bag of coded messages
(`write_coded`) is decoded by our plug-in for `point_cloud_transport`, and by our extension for Foxglove.

>>> import io
>>> from lidarcodec.packet import Packet
>>> file = io.BytesIO()
>>> with RosbagWriter(file) as writer:
...     writer.write_scan([Packet(bytes(1206), 1_700_000_000_000_000_123)])
>>> [(topic.name, topic.count) for topic in writer.topics]
[('/velodyne_packets', 1)]
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import IO, Any, Final

import yaml

from lidarcodec import wire
from lidarcodec.cloud import Returns
from lidarcodec.errors import DecodeError
from lidarcodec.frame import Frame
from lidarcodec.interop import ros
from lidarcodec.interop.compressed_cloud import coded_topic, compressed_cloud
from lidarcodec.interop.point_cloud2 import cdr_of, point_cloud2, tf_message
from lidarcodec.interop.velodyne_scan import scan_of
from lidarcodec.mounting import Matrix, is_same, vehicle_pose
from lidarcodec.packet import Packet
from lidarcodec.recording.mcap_file import McapFile
from lidarcodec.sensors.clouds.message import ROS1

PROFILE: Final = "ros2"
ENCODING: Final = "cdr"
PACKETS_TOPIC: Final = "/velodyne_packets"
CLOUDS_TOPIC: Final = "/points"
"""Of point clouds that were messages."""
POINTS_TOPIC: Final = "/velodyne_points"
TF_TOPIC: Final = "/tf"
STATIC_TF_TOPIC: Final = "/tf_static"
FRAME_ID: Final = "velodyne"
WORLD: Final = "map"
VEHICLE: Final = "base_link"
"""Names of the frames of poses and of the vehicle in ROS (REP 105)."""
_LATCHED: Final = """- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline: {sec: 2147483647, nsec: 4294967295}
  lifespan: {sec: 2147483647, nsec: 4294967295}
  liveliness: 1
  liveliness_lease_duration: {sec: 2147483647, nsec: 4294967295}
  avoid_ros_namespace_conventions: false
"""
"""Quality of service of /tf_static: reliable, and kept for listeners that come later (transient local)."""
METADATA: Final = "metadata.yaml"
"""Name of the file beside the messages in the folder of a bag."""
_CHUNK: Final = 2**20
_INFORMATION_VERSION: Final = 5
"""Version of metadata.yaml that every ROS 2 since Humble reads."""


@dataclass
class Topic:
    """A written topic: its name, its type, its number of messages, and its quality of service if that matters."""

    name: str
    type: ros.RosType
    channel: int
    quality: str = ""
    count: int = 0


class RosbagWriter(McapFile):
    """Writes to an open binary file, which the caller closes.

    topics: the topics written so far;  left_out: messages that a bag of ROS 2 cannot hold
    """

    def __init__(
        self,
        stream: IO[bytes],
        *,
        packets_topic: str = PACKETS_TOPIC,
        points_topic: str = POINTS_TOPIC,
        frame_id: str = FRAME_ID,
    ) -> None:
        """frame_id: of packets and points."""
        super().__init__(stream, _CHUNK, compressed=True, profile=PROFILE)
        self._packets_topic, self._points_topic, self.frame_id = packets_topic, points_topic, frame_id
        self._topics: dict[str, Topic] = {}
        self._mount: Matrix | None = None
        self._first_ns = self._last_ns = self.left_out = 0

    @property
    def topics(self) -> list[Topic]:
        """The topics written so far."""
        return list(self._topics.values())

    def write_scan(self, packets: Sequence[Packet]) -> None:
        """Add consecutive packets, for example of one turn, as a message. No packets give no message.

        Raises SectionError for times that ROS cannot hold, PacketError, OSError.
        """
        if packets:
            data = scan_of(packets, self.frame_id)
            self._add(self._packets_topic, ros.VELODYNE_SCAN, packets[-1].stamp_ns, data)

    def write_cloud(self, frame: Frame, returns: Returns = "first") -> None:
        """Add the points of a frame, its pose if it has one, and its mounting when it is new. Raises OSError.

        returns: `all` for second returns, too, and a field `return_number`
        """
        self._place(frame.stamp_ns, frame.pose, frame.mount)
        self._add(
            self._points_topic, ros.POINT_CLOUD2, frame.stamp_ns, point_cloud2(frame, self.frame_id, returns=returns)
        )

    def write_message(
        self, stamp_ns: int, payload: bytes, pose: Matrix | None = None, mount: Matrix | None = None
    ) -> None:
        """Add a message of a topic of `sensor_msgs/PointCloud2` as it is, whatever is in it, and where the sensor is.
        One of ROS 1 becomes one of ROS 2, without its number; one that cannot, because it is no whole PointCloud2, is
        counted in `left_out`.

        Raises OSError.
        """
        try:
            data = cdr_of(payload) if payload[:4] == ROS1 else payload
        except DecodeError:
            self.left_out += 1
            return
        self._place(stamp_ns, pose, mount)
        self._add(self._points_topic, ros.POINT_CLOUD2, stamp_ns, data)

    def write_coded(self, data: bytes, pose: Matrix | None = None, mount: Matrix | None = None) -> None:
        """Add a message of lidarcodec as it is, the pose that it carries, and its mounting when that is new.

        Raises DecodeError for bytes that do not begin as a message, OSError.
        """
        stamp_ns = wire.peek(data).stamp_ns
        self._place(stamp_ns, pose, mount)
        coded = compressed_cloud(data, stamp_ns, self.frame_id)
        self._add(coded_topic(self._points_topic), ros.COMPRESSED_CLOUD, stamp_ns, coded)

    def _place(self, stamp_ns: int, pose: Matrix | None, mount: Matrix | None) -> None:
        """Say where the sensor is: T_world_sensor and T_vehicle_sensor, as far as they are known."""
        if mount is not None and not is_same(mount, self._mount):
            self._mount = mount
            data = tf_message(stamp_ns, VEHICLE, self.frame_id, mount)
            self._add(STATIC_TF_TOPIC, ros.TF_MESSAGE, stamp_ns, data, _LATCHED)
        if pose is not None:
            child = self.frame_id if mount is None else VEHICLE
            data = tf_message(stamp_ns, WORLD, child, vehicle_pose(pose, mount))
            self._add(TF_TOPIC, ros.TF_MESSAGE, stamp_ns, data)

    def not_kept(self) -> str:
        """What was left out, as a sentence; empty if nothing was."""
        if not self.left_out:
            return ""
        return f"{self.left_out} messages of ROS 1 that are no whole PointCloud2 were left out: .npz holds them"

    def metadata(self, name: str) -> str:
        """The contents of `metadata.yaml` in the bag's folder. name: name of this file"""
        total = sum(topic.count for topic in self.topics)
        times: dict[str, Any] = {
            "duration": {"nanoseconds": self._last_ns - self._first_ns},
            "starting_time": {"nanoseconds_since_epoch": self._first_ns},
            "message_count": total,
        }
        about = {
            "version": _INFORMATION_VERSION,
            "storage_identifier": "mcap",
            **times,
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": topic.name,
                        "type": topic.type.name,
                        "serialization_format": ENCODING,
                        "offered_qos_profiles": topic.quality,
                    },
                    "message_count": topic.count,
                }
                for topic in self.topics
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [name],
            "files": [{"path": name, **copy.deepcopy(times)}],  # a shared object would become a YAML anchor
        }
        return yaml.safe_dump({"rosbag2_bagfile_information": about}, sort_keys=False)

    def _add(self, name: str, kind: ros.RosType, stamp_ns: int, data: bytes, quality: str = "") -> None:
        topic = self._topics.get(name)
        if topic is None:
            schema = self._mcap.register_schema(kind.name, "ros2msg", kind.definition.encode())
            metadata = {"offered_qos_profiles": quality, "topic_type_hash": kind.type_hash}
            channel = self._mcap.register_channel(name, ENCODING, schema, metadata)
            topic = self._topics[name] = Topic(name, kind, channel, quality)
        at = max(0, stamp_ns)
        began = any(one.count for one in self.topics)
        self._first_ns = min(self._first_ns, at) if began else at
        self._last_ns = max(self._last_ns, at)
        self._add_message(topic.channel, at, data, topic.count)
        topic.count += 1
