"""Points as KITTI writes them (.bin), a file for each frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lidarcodec.commands.outputs.base import Cloud, check_near
from lidarcodec.frame import Frame


class KittiScan:
    """float32 x y z and reflectance (intensity / 255, of sensors that send 16 bits / 65535), ring by ring as in
    KITTI."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def write(self, frame: Frame, cloud: Cloud) -> None:
        check_near(frame, cloud, ".bin")
        order = np.argsort(cloud["ring"], kind="stable")
        rows = np.empty((len(cloud), 4), "<f4")
        for at, axis in enumerate("xyz"):
            rows[:, at] = cloud[axis][order]
        top = 255 if frame.sensor.is_cloud else np.iinfo(cloud["intensity"].dtype).max
        rows[:, 3] = cloud["intensity"][order] / np.float32(top)
        self._path.write_bytes(rows.tobytes())

    def close(self) -> None:
        """Nothing is left to do."""
