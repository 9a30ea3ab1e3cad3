"""Output formats of `decode`: packets (.pcap), clouds as messages of ROS 2 (.mcap), images (.npz), points (.ply, .las),
or a folder of KITTI .bin files.

All of them write frame by frame, so a long recording needs no more memory than a short one.
"""

from __future__ import annotations

import json
import logging
import re
import zipfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from lidarcodec.assembly import packets_of
from lidarcodec.errors import MissingExtraError, SettingsError
from lidarcodec.files.whole import check_free
from lidarcodec.frame import Frame
from lidarcodec.recording import RosbagWriter
from lidarcodec.recording.rosbag import CLOUDS_TOPIC
from lidarcodec.sensor_model import CALIBRATION_FIELDS, SensorModel
from lidarcodec.sensors.clouds.points import payload_of
from lidarcodec.side import SideInfo
from lidarcodec.sources.captures.pcap_writer import PcapWriter

log = logging.getLogger(__name__)

KITTI_FILES: Final = re.compile(r"\d{6,}\.bin|timestamps\.json")
"""Names of the files in a folder of KITTI .bin files."""


class Output(Protocol):
    """A file or folder for frames; `close` completes it."""

    def write(self, frame: Frame) -> None:
        """Append one frame."""

    def close(self) -> None:
        """Finish the file."""


class PcapOutput:
    """Writes the packets as the sensor sent them, with their host times."""

    def __init__(self, path: Path) -> None:
        self._handle = path.open("wb")
        self._writer = PcapWriter(self._handle)

    def write(self, frame: Frame) -> None:
        if frame.sensor.is_cloud:
            raise SettingsError("a capture cannot hold point clouds: write .mcap, .npz, .ply or .las")
        for packet in packets_of(frame):
            self._writer.write(packet)

    def close(self) -> None:
        self._handle.close()


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

    def write(self, frame: Frame) -> None:
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


class PlyOutput:
    """Binary PLY: x y z in metres, intensity (16 bits if the sensor sends 16, and of point clouds), laser, ring, frame,
    and t in seconds since the first point."""

    DTYPE: Final = np.dtype(
        [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "u1"), ("laser", "u1"), ("ring", "u1"),
         ("frame", "<i4"), ("t", "<f8")]
    )  # fmt: skip
    WIDE: Final = np.dtype(
        [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<u2"), ("laser", "u1"), ("ring", "u1"),
         ("frame", "<i4"), ("t", "<f8")]
    )  # fmt: skip
    TYPE_NAMES: Final = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "i4": "int"}
    COUNT_DIGITS: Final = 12

    def __init__(self, path: Path) -> None:
        self._handle = path.open("wb")
        self._count = 0
        self._start_ns: int | None = None
        self._dtype = self.DTYPE
        self._clipped = False

    def _write_header(self) -> None:
        # The number of points is known only at the end. It then overwrites the first number; both are padded to one
        # length.
        properties = "".join(
            f"property {self.TYPE_NAMES[self._dtype[name].str[1:]]} {name}\n" for name in self._dtype.names or ()
        )
        padding = "0" * (self.COUNT_DIGITS - len(str(self._count)))
        self._handle.write(
            f"ply\nformat binary_little_endian 1.0\ncomment lidarcodec {padding}\n"
            f"element vertex {self._count}\n{properties}end_header\n".encode()
        )

    def write(self, frame: Frame) -> None:
        cloud = frame.cloud()
        if self._start_ns is None:
            self._start_ns = frame.stamp_ns
            self._dtype = self.WIDE if _is_wide(frame, cloud) else self.DTYPE
            self._write_header()
        rows = np.empty(len(cloud), self._dtype)
        for name in ("x", "y", "z", "laser", "ring"):
            rows[name] = cloud[name]
        top = np.iinfo(self._dtype["intensity"]).max
        if not self._clipped and cloud["intensity"].max(initial=0) > top:
            self._clipped = True
            log.warning(
                "intensities from frame %d on are clipped to %d, for the first sensor has 8 bits", frame.index, top
            )
        rows["intensity"] = np.minimum(cloud["intensity"].astype(np.uint16), top)
        if frame.index > np.iinfo(np.int32).max:
            raise SettingsError(f"the number of frame {frame.index} is too large for .ply: write .npz or .pcap")
        rows["frame"] = frame.index
        rows["t"] = (cloud["t_ns"] - self._start_ns) * 1e-9
        self._handle.write(rows.tobytes())
        self._count += len(rows)

    def close(self) -> None:
        self._handle.seek(0)
        self._write_header()
        self._handle.close()


class LasOutput:
    """LAS 1.4 in millimetres: intensity scaled to 16 bits (of point clouds as it is), user_data = ring, point_source_id
    = laser, gps_time = host time in seconds since the Unix epoch."""

    STEP_M: Final = 0.001

    def __init__(self, path: Path) -> None:
        import laspy

        header = laspy.LasHeader(point_format=6, version="1.4")
        header.scales = np.full(3, self.STEP_M)
        header.offsets = np.zeros(3)
        header.generating_software = "lidarcodec"
        self._header = header
        self._writer = laspy.open(path, mode="w", header=header)

    def write(self, frame: Frame) -> None:
        import laspy

        cloud = frame.cloud()
        points = laspy.ScaleAwarePointRecord.zeros(len(cloud), header=self._header)
        try:
            points.x, points.y, points.z = (cloud[axis].astype(np.float64) for axis in "xyz")
        except OverflowError:
            raise SettingsError(f"points of frame {frame.index} are too far away for .las: write .ply") from None
        wide = cloud["intensity"].astype(np.uint16)
        points.intensity = wide if _is_wide(frame, cloud) else wide * 257
        points.user_data = cloud["ring"]
        points.point_source_id = cloud["laser"].astype(np.uint16)
        points.gps_time = cloud["t_ns"] * 1e-9
        points.return_number = np.ones(len(cloud), np.uint8)
        points.number_of_returns = np.ones(len(cloud), np.uint8)
        self._writer.write_points(points)

    def close(self) -> None:
        self._writer.close()


class KittiOutput:
    """One file for each frame, `000000.bin`: float32 x y z and reflectance (intensity / 255, of sensors that send 16
    bits / 65535), ring by ring as in KITTI. `timestamps.json` has the host time of each frame in ns."""

    def __init__(self, path: Path) -> None:
        path.mkdir(parents=True, exist_ok=True)
        self._folder = path
        self._stamps: dict[str, int] = {}

    def write(self, frame: Frame) -> None:
        cloud = frame.cloud()
        order = np.argsort(cloud["ring"], kind="stable")
        rows = np.empty((len(cloud), 4), "<f4")
        for at, axis in enumerate("xyz"):
            rows[:, at] = cloud[axis][order]
        top = 255 if frame.sensor.is_cloud else np.iinfo(cloud["intensity"].dtype).max
        rows[:, 3] = cloud["intensity"][order] / np.float32(top)
        name = f"{len(self._stamps):06d}.bin"
        (self._folder / name).write_bytes(rows.tobytes())
        self._stamps[name] = frame.stamp_ns

    def close(self) -> None:
        (self._folder / "timestamps.json").write_text(json.dumps(self._stamps, indent=1) + "\n")


def _is_wide(frame: Frame, cloud: npt.NDArray[np.void]) -> bool:
    """Whether intensities of a stream have 16 bits. Messages of a point cloud have the type that each of them needs."""
    return frame.sensor.is_cloud or cloud["intensity"].dtype != np.uint8


class BagOutput:
    """A bag of ROS 2 with a `sensor_msgs/PointCloud2` a frame: the very message where the frame was one."""

    def __init__(self, path: Path) -> None:
        self._handle = path.open("wb")
        self._writer = RosbagWriter(self._handle, points_topic=CLOUDS_TOPIC)

    def write(self, frame: Frame) -> None:
        if frame.sensor.is_cloud:
            self._writer.write_message(frame.stamp_ns, payload_of(frame))
        else:
            self._writer.write_cloud(frame)

    def close(self) -> None:
        self._writer.close()
        self._handle.close()
        if self._writer.left_out:
            log.warning("%s", self._writer.not_kept())


OUTPUTS: Final[dict[str, Callable[[Path], Output]]] = {
    ".pcap": PcapOutput,
    ".mcap": BagOutput,
    ".npz": NpzOutput,
    ".ply": PlyOutput,
    ".las": LasOutput,
    "": KittiOutput,
}


def _suffix(path: Path) -> str:
    return "" if path.is_dir() else path.suffix.lower()


def check_output(path: Path, *, force: bool = False) -> None:
    """Raise SettingsError if the ending of a path is unknown, or writing would replace an existing output;
    MissingExtraError if the library for this format is not installed."""
    suffix = _suffix(path)
    if suffix not in OUTPUTS:
        raise SettingsError(
            f"cannot write {path}: its name must end in .pcap .mcap .npz .ply or .las, or be a folder for KITTI scans"
        )
    if suffix == ".las" and find_spec("laspy") is None:
        raise MissingExtraError(f"writing {path}", "las")
    if suffix != ".pcap" and (path.is_fifo() or path.is_char_device()):
        raise SettingsError(f"{path} is a pipe or a device: only packets (.pcap) can be written to it")
    check_free(path, force=force, contents=contents_of(path))


def contents_of(path: Path) -> re.Pattern[str] | None:
    """Names of the files in an output folder; None if the output is a file."""
    return None if _suffix(path) else KITTI_FILES


def open_output(path: Path, beside: Path) -> Output:
    """The output with the format of `path`'s ending, written to `beside`. A path without an ending is a folder of KITTI
    .bin files.

    Raises OSError if it cannot be written.
    """
    return OUTPUTS[_suffix(path)](beside)
