"""The table of sources, and `open_source`, which opens a path or an address.

Modules are named as text and imported on first use, so unused ones cost nothing.

>>> open_source("tcp://somewhere")
Traceback (most recent call last):
lidarcodec.errors.UnknownNameError: unknown kind of source 'tcp': choose one of a path, udp, ros2, sim
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Protocol, cast

from lidarcodec.errors import SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.sensor_model import Convention
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.magic import BAG_MAGIC, MCAP_MAGIC, SQLITE_MAGIC
from lidarcodec.sources.pacing import PacedSource
from lidarcodec.sources.poses import Poses, read_poses
from lidarcodec.sources.spec import Spec, parse
from lidarcodec.sources.unit_calibration import warn_if_generic

TABLE: dict[str, str] = {
    "udp": "lidarcodec.sources.udp.source:UdpSource",
    "ros2": "lidarcodec.bridges.ros_source:RosSource",
    "sim": "lidarcodec.sources.simulator:SimulatorSource",
    "folder": "lidarcodec.sources.kitti.source:KittiSource",
    "recording": "lidarcodec.sources.recording:RecordingSource",
    "rosbag": "lidarcodec.sources.rosbag.source:RosbagSource",
    "capture": "lidarcodec.sources.captures.source:CaptureSource",
}
"""Kind -> module and class, which has a constructor `from_spec(spec, calibration)`."""
SCHEMES = ("udp", "ros2", "sim")
SCAN_SUFFIXES = (".bin", ".bin.xz")


class SourceClass(Protocol):
    """A class in the table."""

    def from_spec(self, spec: Spec, calibration: Path | None) -> PacketSource:
        """The opened source of a spec."""


def open_source(
    spec: str | Path | Spec,
    *,
    calibration: str | Path | None = None,
    poses: str | Path | None = None,
    realtime: bool = False,
    convention: Convention = "ros",
    speed: float = 1.0,
    loop: bool = False,
    restamp: bool = False,
    points: bool = True,
) -> PacketSource:
    """The source that a path, `udp://HOST:PORT` or `sim:SCENE?...` names, opened.

    calibration: a db.xml or ROS yaml; by default one found beside the file or in the stream, or a generic one
    poses:       a file of poses for `source.poses`
    realtime:    packets come at the sensor's own pace times `speed`, again and again with `loop`, stamped with the time
                 of now with `restamp`
    points:      whether points are made of its frames, so that a generic calibration deserves a warning
    Raises SourceError, UnknownNameError (kind or option), CalibrationError, PacketError for another sensor.
    """
    parsed = spec if isinstance(spec, Spec) else parse(spec, SCHEMES)
    kind = kind_of(parsed)
    source = _class(kind).from_spec(parsed, None if calibration is None else Path(calibration))
    try:
        path = parsed.path if kind in ("capture", "recording") else None
        if points and not getattr(source, "silent", False):
            warn_if_generic(source.sensor, source.label if source.live else parsed.text, path, live=source.live)
        source.sensor = source.sensor.with_convention(convention)
        if poses is not None:
            source.poses = _poses(Path(poses), source)
        if (realtime or loop or restamp) and not source.live:
            return PacedSource(source, speed=speed if realtime else float("inf"), loop=loop, restamp=restamp)
    except BaseException:
        source.close()
        raise
    return source


def kind_of(spec: Spec) -> str:
    """Key in the table for a spec: by its scheme, or by the contents of the path.

    Raises SourceError if there is nothing at that path.
    """
    if spec.scheme:
        return spec.scheme
    path = spec.path
    try:
        if path.is_dir():
            return "rosbag" if (path / "metadata.yaml").is_file() else "folder"
        if path.name.endswith(SCAN_SUFFIXES):
            return "folder"
        with open_regular(path) as file:
            begins = file.read(len(SQLITE_MAGIC))
        found = begins == SQLITE_MAGIC or begins[: len(BAG_MAGIC)] == BAG_MAGIC
        if begins[: len(MCAP_MAGIC)] == MCAP_MAGIC:
            from lidarcodec.sources.rosbag.source import is_rosbag

            found = is_rosbag(path)
    except FileNotFoundError:
        raise SourceError(f"{path} does not exist") from None
    except OSError as error:
        raise SourceError(f"cannot open {path}: {error.strerror or error}") from None
    if found:
        return "rosbag"
    return "recording" if begins[: len(MCAP_MAGIC)] == MCAP_MAGIC else "capture"


def _poses(path: Path, source: PacketSource) -> Poses:
    poses = read_poses(path)
    if poses.relative and source.start_ns is None:
        raise SourceError(
            f"{path} has only relative times, and the start time of the source is not known: give absolute times"
        )
    return poses.starting(source.start_ns or 0)


def _class(kind: str) -> SourceClass:
    module, _, name = TABLE[kind].partition(":")
    return cast(SourceClass, getattr(importlib.import_module(module), name))
