"""Labels of KITTI: boxes of a drive by the number of their frame.

`label_02/NNNN.txt` of the tracking benchmark has a line for each object: frame, track, kind, truncation, occlusion,
angle, four numbers of the image, height, width, length, the place of its lower side's middle in the rectified camera,
and its turn about the camera's y. It needs the file of the camera's calibration, `calib/NNNN.txt`.
`tracklet_labels.xml` of the raw drives is in the frame of the sensor. Both are described in KITTI's
development kits (Geiger et al. 2013). Only what the camera sees is labelled.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

import numpy as np

from lidarcodec.budgets import MIB
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.evaluation.detection.boxes import Boxes, joined, upright
from lidarcodec.evaluation.rigid import Matrix, invert
from lidarcodec.files.regular import open_regular
from lidarcodec.untrusted.xml import XmlRefusedError, read_xml

MOST_BYTES: Final = 32 * MIB
MOST_ELEMENTS: Final = 500_000
MOST_FRAMES: Final = 1_000_000
MOST_BOXES: Final = 100_000
LARGEST_M: Final = 100.0
FARTHEST_M: Final = 10_000.0
FIELDS: Final = 17
"""Of a line of the tracking benchmark."""
NOT_OBJECTS: Final = frozenset({"dontcare", "misc"})
RECTIFIED: Final = ("R0_rect", "R_rect")
SENSOR_TO_CAMERA: Final = ("Tr_velo_to_cam", "Tr_velo_cam")
Labels = Mapping[int, Boxes]


def read_labels(path: Path, camera: Path | None = None) -> Labels:
    """Boxes by the number of their frame, in the frame of the sensor.

    camera: calibration of the camera, for labels in a text file
    Raises SourceError for a file that cannot be read, SettingsError for a missing calibration.
    """
    data = _read(path)
    if path.suffix.lower() == ".xml":
        return _tracklets(data, path)
    if camera is None:
        raise SettingsError(
            f"the labels in {path} are in the frame of a camera: give its calibration with --camera FILE", "camera"
        )
    return _tracking(_text(data), path, _camera_to_sensor(_text(_read(camera)), camera))


def _read(path: Path) -> bytes:
    try:
        with open_regular(path) as handle:
            data = handle.read(MOST_BYTES + 1)
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}") from error
    if len(data) > MOST_BYTES:
        raise SourceError(f"{path} is larger than {MOST_BYTES // MIB} MiB, so it is not a file of labels")
    return data


def _text(data: bytes) -> str:
    return data.decode("utf-8", "replace")


def _camera_to_sensor(text: str, path: Path) -> Matrix:
    """(4, 4) T_sensor_camera of the rectified camera."""
    rows: dict[str, list[float]] = {}
    for line in text.splitlines()[:1000]:
        name, *values = line.replace(":", " ").split() or [""]
        try:
            rows[name] = [float(value) for value in values]
        except ValueError:
            continue
    rectified = next((rows[name] for name in RECTIFIED if len(rows.get(name, ())) == 9), None)
    moved = next((rows[name] for name in SENSOR_TO_CAMERA if len(rows.get(name, ())) == 12), None)
    if rectified is None or moved is None or not np.all(np.isfinite([*rectified, *moved])):
        raise SourceError(f"{path} is not a calibration of a camera: R0_rect or Tr_velo_to_cam is missing")
    turn, whole = np.eye(4), np.eye(4)
    turn[:3, :3] = np.reshape(rectified, (3, 3))
    whole[:3] = np.reshape(moved, (3, 4))
    for rotation in (turn, whole):
        if np.abs(rotation[:3, :3] @ rotation[:3, :3].T - np.eye(3)).max() > 0.01:
            raise SourceError(f"{path} is not a calibration of a camera: a matrix in it is not a rotation")
    return invert(turn @ whole)


def _tracking(text: str, path: Path, to_sensor: Matrix) -> Labels:
    frames: dict[int, list[Boxes]] = {}
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words:
            continue
        if number > MOST_BOXES:
            raise SourceError(f"{path} has more than {MOST_BOXES} lines, so it is not a file of labels")
        try:
            frame, track, kind = int(words[0]), int(words[1]), words[2].lower()
            height, width, length, x, y, z, turn = (float(word) for word in words[10:FIELDS])
        except (ValueError, IndexError):
            raise SourceError(f"{path}, line {number}: this is not a label of KITTI's tracking benchmark") from None
        if kind in NOT_OBJECTS:
            continue
        _check(path, f"line {number}", frame, [length, width, height], [x, y, z, turn])
        c, s = math.cos(turn), math.sin(turn)
        along, up = np.array([c, 0.0, -s]), np.array([0.0, -1.0, 0.0])
        axes = np.stack((along, np.cross(up, along), up)) @ to_sensor[:3, :3].T
        middle = to_sensor[:3, :3] @ np.array([x, y - height / 2, z]) + to_sensor[:3, 3]
        box = Boxes((kind,), (track,), middle[None], axes[None], np.array([[length, width, height]]))
        frames.setdefault(frame, []).append(box)
    return _by_frame(frames, path)


def _tracklets(data: bytes, path: Path) -> Labels:
    try:
        root = read_xml(data, most_elements=MOST_ELEMENTS)
    except XmlRefusedError as error:
        raise SourceError(f"{path}: {error}") from error
    frames: dict[int, list[Boxes]] = {}
    for track, item in enumerate(root.iterfind("tracklets/item")):
        kind = (item.findtext("objectType") or "").strip().lower()
        if kind in NOT_OBJECTS:
            continue
        first = int(_number(item, "first_frame", path))
        size = [_number(item, name, path) for name in "lwh"]
        for later, pose in enumerate(item.iterfind("poses/item")):
            x, y, z, turn = (_number(pose, name, path) for name in ("tx", "ty", "tz", "rz"))
            _check(path, f"tracklet {track}", first + later, size, [x, y, z, turn])
            middle = np.array([[x, y, z + size[2] / 2]])
            box = upright((kind,), (track,), middle, np.array([size]), np.array([turn]))
            frames.setdefault(first + later, []).append(box)
    return _by_frame(frames, path)


def _number(element: ElementTree.Element, name: str, path: Path) -> float:
    try:
        value = float(element.findtext(name) or "")
    except ValueError:
        value = math.nan
    if not abs(value) < MOST_FRAMES:
        raise SourceError(f"{path}: a tracklet has no {name}")
    return value


def _check(path: Path, where: str, frame: int, size: list[float], place: list[float]) -> None:
    if not abs(frame) <= MOST_FRAMES:
        raise SourceError(f"{path}, {where}: there is no frame {frame}")
    if not all(0 < value < LARGEST_M for value in size) or not all(abs(value) < FARTHEST_M for value in place):
        raise SourceError(f"{path}, {where}: this is not the box of an object")


def _by_frame(frames: dict[int, list[Boxes]], path: Path) -> Labels:
    if not frames:
        raise SourceError(f"{path} has no label of an object")
    return {frame: joined(boxes) for frame, boxes in frames.items()}
