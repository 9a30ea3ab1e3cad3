"""Test vectors of point clouds (model `pointcloud2`): their streams, and what every message must become."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from lidarcodec.errors import DecodeError
from lidarcodec.frame import Frame
from lidarcodec.image_frame import cloud_frame
from lidarcodec.message import Message
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.sensors.clouds.message import read_message
from lidarcodec.sensors.clouds.points import payload_of
from lidarcodec.sensors.clouds.sensor import cloud_sensor
from lidarcodec.settings import settings_from
from lidarcodec_server.live.cloud_image import cloud_image
from tests.planes.cloud_messages import other_order, several, with_nan
from tests.point_clouds import message, nebula, ouster, ros1, velodyne
from tests.vectors.digest import digest

FOLDER = Path(__file__).parent / "point_clouds"
STREAM = 0x0C10_0D5A_0000_0007
STREAMS: dict[str, dict[str, Any]] = {
    "raw": {"codec": "raw"},
    "zstd": {"codec": "zstd"},
    "zstd_bounded": {"codec": "zstd", "max_error_m": 0.02},
    "pcodec": {"codec": "pcodec"},
    "riddle": {"codec": "riddle"},
    "predictive": {"codec": "predictive"},
    "predictive_bounded": {"codec": "predictive", "max_error_m": 0.01},
}


def payloads() -> list[bytes]:
    """Clouds that differ in their fields, order and form, and payloads that are no cloud."""
    turn = velodyne(60)
    rng = np.random.default_rng(6)
    angle, up = rng.uniform(-np.pi, np.pi, 200), rng.uniform(-0.17, 0.17, 200)
    anywhere = np.zeros(200, [(axis, "<f4") for axis in "xyz"])
    for axis, part in zip("xyz", (np.cos(angle) * np.cos(up), np.sin(angle) * np.cos(up), np.sin(up)), strict=True):
        anywhere[axis] = 8.0 * part
    return [
        message(turn),
        message(ouster(64), 16),
        message(nebula(60)),
        message(ouster(32, nan=True), 16, padding=b"\1\2\3", tail=b"more"),
        ros1(message(velodyne(40, 8))),
        other_order(),
        several(),
        with_nan(),
        message(np.random.default_rng(4).permutation(turn)),
        message(anywhere),
        message(turn[:0]),
        message(turn[:1]),
        np.random.default_rng(5).bytes(300),
    ]


def messages_of(settings: dict[str, Any]) -> list[Message]:
    """The messages of a stream; each cloud is of a sensor of its own."""
    encoder = StreamEncoder(settings_from({"key_interval": 1, **settings}), STREAM)
    sent = [cloud_frame(i, 10**18 + i, one, cloud_sensor([one])) for i, one in enumerate(payloads())]
    return [one for frame in sent for one in encoder.encode(frame)]


def expected_of_cloud(frame: Frame) -> dict[str, Any]:
    """What a decoder must find. Points: the first, middle and last; `shown` is what the server gives to viewers."""
    payload, cloud, image = payload_of(frame), frame.cloud(), cloud_image(frame)
    ends = [cloud[at] for at in (0, len(cloud) // 2, len(cloud) - 1)] if len(cloud) else []
    try:
        fields = [[one.name, one.kind, one.repeated] for one in read_message(payload).head.fields]
    except DecodeError:
        fields = []
    return {
        "stream": str(STREAM),
        "index": str(frame.index),
        "stamp_ns": str(frame.stamp_ns),
        "sensor": [frame.sensor.name, frame.sensor.hash, frame.sensor.convention, frame.sensor.range_step_m],
        "rows": frame.sensor.rows,
        "message": digest(np.frombuffer(payload, np.uint8)),
        "bytes": len(payload),
        "fields": fields,
        "returns": len(cloud),
        "points": [[float(one[axis]) for axis in "xyz"] for one in ends],
        "shown": {
            "rows": len(image.ranges),
            "columns": len(image.azimuth),
            "drawn": image.drawn,
            "range": int(image.ranges.astype(np.int64).sum()),
            "intensity": int(image.intensity.astype(np.int64).sum()),
            "step_m": image.step_m,
        },
    }
