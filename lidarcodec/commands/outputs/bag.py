"""Clouds as messages of ROS 2 (.mcap)."""

from __future__ import annotations

import logging
from pathlib import Path

from lidarcodec.commands.outputs.base import Cloud
from lidarcodec.frame import Frame
from lidarcodec.recording import RosbagWriter
from lidarcodec.recording.rosbag import CLOUDS_TOPIC
from lidarcodec.sensors.clouds.points import payload_of

log = logging.getLogger(__name__)


class BagOutput:
    """A bag of ROS 2 with a `sensor_msgs/PointCloud2` a frame: the very message where the frame was one."""

    def __init__(self, path: Path) -> None:
        self._handle = path.open("wb")
        self._writer = RosbagWriter(self._handle, points_topic=CLOUDS_TOPIC)

    def write(self, frame: Frame, cloud: Cloud) -> None:
        if frame.sensor.is_cloud:
            self._writer.write_message(frame.stamp_ns, payload_of(frame))
        else:
            self._writer.write_cloud(frame)

    def close(self) -> None:
        self._writer.close()
        self._handle.close()
        if self._writer.left_out:
            log.warning("%s", self._writer.not_kept())
