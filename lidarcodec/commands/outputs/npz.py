"""Images with the sensor's integers (.npz)."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import numpy.typing as npt

from lidarcodec.commands.outputs.base import Cloud
from lidarcodec.frame import Frame
from lidarcodec.sensor_model import CALIBRATION_FIELDS, SensorModel
from lidarcodec.sensors.clouds.points import payload_of
from lidarcodec.side import SideInfo


class NpzOutput:
    """Images with the sensor's integers, one folder for each frame: `000000/range`, `/intensity`, `/azimuth`, `/fired`,
    `/index`, `/stamp_ns`, `/column_ns` (HDL-64E), further planes by name (other sensors), and `/calibration`, the HASH
    of the table `calibration/HASH`. A message of a point cloud also has `/points` and `/message`, its bytes."""

    def __init__(self, path: Path) -> None:
        self._zip = zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
        self._known: set[str] = set()
        self._count = 0

    def _add(self, name: str, array: npt.ArrayLike) -> None:
        with self._zip.open(f"{name}.npy", "w", force_zip64=True) as member:
            np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)

    def _add_calibration(self, sensor: SensorModel) -> None:
        if not self._known:
            self._add("calibration/fields", np.array(list(CALIBRATION_FIELDS)))
            self._add("calibration/steps", np.array(list(CALIBRATION_FIELDS.values())))
        if sensor.hash not in self._known:
            self._add(f"calibration/{sensor.hash}", sensor.calibration.table)
            self._known.add(sensor.hash)

    def write(self, frame: Frame, cloud: Cloud) -> None:
        self._add_calibration(frame.sensor)
        parts: dict[str, npt.ArrayLike] = {
            "range": np.where(frame.valid, frame.range, frame.range.dtype.type(0)),
            "intensity": frame.intensity,
            "azimuth": frame.azimuth,
            "fired": frame.fired,
            "index": np.int64(frame.index),
            "stamp_ns": np.int64(frame.stamp_ns),
            "calibration": np.array(frame.sensor.hash),
        }
        if isinstance(frame.side, SideInfo):
            parts["column_ns"] = frame.side.column_ns
        parts |= frame.planes
        if frame.sensor.is_cloud:
            parts |= {"points": frame.cloud(), "message": np.frombuffer(payload_of(frame), np.uint8)}
        for name, array in parts.items():
            self._add(f"{self._count:06d}/{name}", array)
        self._count += 1

    def close(self) -> None:
        self._zip.close()
