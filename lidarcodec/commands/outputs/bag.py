"""Clouds as messages of ROS 2: a file (.mcap), or the folder of a rosbag2."""

from __future__ import annotations

import logging
from pathlib import Path

from lidarcodec.cloud import Returns
from lidarcodec.commands.outputs.base import USUAL, BagNames, Cloud
from lidarcodec.frame import Frame
from lidarcodec.interop.point_cloud2 import frame_of_points
from lidarcodec.recording import RosbagWriter
from lidarcodec.recording.rosbag import CLOUDS_TOPIC, METADATA
from lidarcodec.sensors.clouds.points import payload_of
from lidarcodec.sensors.models.table import frame_id_of

logger = logging.getLogger(__name__)


class BagOutput:
    """A bag of ROS 2 with a `sensor_msgs/PointCloud2` a frame: the very message where the frame was one.

    path: of its file, or its folder, which exists;  folder: the name that the folder will have
    returns: the first return of each beam, or all, with a field `return_number`
    """

    def __init__(self, path: Path, names: BagNames = USUAL, *, folder: str = "", returns: Returns = "first") -> None:
        self._returns = returns
        self._folder = path if folder else None
        self._file = path / f"{folder}_0.mcap" if folder else path
        self._frame_id = names.frame_id
        self._handle = self._file.open("wb")
        self._writer = RosbagWriter(self._handle, points_topic=names.topic or CLOUDS_TOPIC)

    def write(self, frame: Frame, cloud: Cloud) -> None:
        name = self._frame_id or frame_id_of(frame.sensor.model)
        self._writer.frame_id = frame_of_points(frame, name)
        if frame.sensor.is_cloud:
            if self._frame_id not in (None, self._writer.frame_id):
                logger.warning("--frame-id is left out: messages of point clouds stay as they are, in their own frame")
                self._frame_id = None
            self._writer.write_message(frame.stamp_ns, payload_of(frame), frame.pose, frame.mount)
            return
        self._writer.write_cloud(frame, self._returns)

    def close(self) -> None:
        self._writer.close()
        self._handle.close()
        if self._folder is not None:
            (self._folder / METADATA).write_text(self._writer.metadata(self._file.name))
        if self._writer.left_out:
            logger.warning("%s", self._writer.not_kept())
