"""The model `pointcloud2`: point clouds that come as messages, of whatever sensor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from lidarcodec.errors import DecodeError
from lidarcodec.sensor_model import POINTCLOUD2, Calibration, SensorModel
from lidarcodec.sensors.clouds.grid import grid_of
from lidarcodec.sensors.clouds.message import CDR, MAX_POINTS, ROS1, CloudMessage, read_head, read_message

RANGE_STEP_M: Final = 0.001
ROWS: Final = (1, 4, 8, 16, 32, 40, 64, 80, 128)
"""Rows that images have: the least of these that hold all rows of a message."""
UNORDERED_ROWS: Final = 64
MAX_NAME_BYTES: Final = 80
_BEAM_RAD: Final = 0.01
"""Between two rows of the nominal calibration. It only says that the first row is the highest."""


def is_cloud(payload: bytes) -> bool:
    """Whether a payload is a PointCloud2 message."""
    return message_of(payload) is not None


def message_of(payload: bytes) -> CloudMessage | None:
    """A payload as message; None if it is none."""
    if payload[:4] != ROS1 and payload[:4] not in CDR:
        return None
    try:
        return read_message(payload)
    except DecodeError:
        return None


def has_points(payload: bytes) -> bool:
    """Whether the head of a payload is that of a PointCloud2 with points."""
    try:
        return read_head(payload).points > 0
    except DecodeError:
        return False


def cloud_evidence(payload: bytes) -> str | None:
    """What a payload is, as a sentence for people; None if it is no PointCloud2."""
    message = message_of(payload)
    if message is None:
        return None
    head = message.head
    fields = " ".join(_shown(one.name) for one in head.fields)
    return f"a PointCloud2 of {head.height} x {head.width} points with {fields}"


def cloud_sensor(payloads: Sequence[bytes]) -> SensorModel:
    """The SensorModel of messages: named after their frame of reference, as far as that can be shown, with the rows of
    the first one with points."""
    messages = [message for payload in payloads if (message := message_of(payload)) is not None]
    seen = (one for one in messages if one.head.points <= MAX_POINTS and one.returns.any())
    first = next(seen, messages[0] if messages else None)
    grid = None if first is None or first.head.points > MAX_POINTS else grid_of(first)
    rows = UNORDERED_ROWS if grid is None else next(rows for rows in ROWS if rows >= grid.rows)
    frame_id = first.head.frame_id if first is not None else ""
    name = _shown(f"PointCloud2 {frame_id}".strip()).encode()[:MAX_NAME_BYTES].decode(errors="ignore")
    elevations = (rows - 1) * _BEAM_RAD / 2 - np.arange(rows) * _BEAM_RAD
    calibration = Calibration.from_values({"vert_correction_rad": elevations})
    return SensorModel(name, calibration, "stream", "veloview", RANGE_STEP_M, POINTCLOUD2)


def _shown(text: str) -> str:
    """A text of a message without characters that would steer a terminal."""
    return "".join(letter for letter in text if letter.isprintable())
