"""AnnotationFolder: the frames, poses and labels of a drive, in files.

annotation.json        settings of the run, and at its end the results
    frames/000000.npz      range (H, W), intensity, stamp_ns of the scan; of an HDL-64E azimuth, fired and column_s (W,)
                           after stamp_ns; of another sensor layout, packet_ns, and series.NAME for each series
    trajectory.npz         T_world_velo (F, 4, 4) at the frames' stamps, and velocities; `--poses` reads it too
    map.npz                points (M, 3) float32, counts (M,) uint16: from how many poses each was seen
    labels/000000.npz      count (H, W) uint16; label (H, W) uint8: 0 none, 1 low, 2 high, 3 ground; threshold

A file is written completely or not at all, so a stopped run continues with the existing files.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, overload

import numpy as np
import numpy.typing as npt

from lidarcodec.budgets import FileTooLargeError, largest, read_file
from lidarcodec.errors import LidarCodecError, SettingsError, SourceError
from lidarcodec.evaluation.trajectory import Scan, Trajectory, scan_of
from lidarcodec.files.whole import written_whole
from lidarcodec.frame import Frame
from lidarcodec.frame_images import INTENSITY, RANGE
from lidarcodec.image_frame import image_frame
from lidarcodec.packet_rest import PacketRest
from lidarcodec.sensor_model import CALIBRATION_FIELDS, Calibration, SensorModel
from lidarcodec.sensors.models.table import sensor_of
from lidarcodec.training.labels import NAMES
from lidarcodec.untrusted.json import JsonRefusedError, read_object
from lidarcodec.untrusted.npz import ArraysRefusedError, read_npz

FORMAT: Final = 1
_SERIES: Final = "series."


class Labels(NamedTuple):
    """counts: (H, W) uint16; labels: (H, W) uint8; threshold: counts above it are high."""

    counts: npt.NDArray[np.uint16]
    labels: npt.NDArray[np.uint8]
    threshold: int


class AnnotationFolder:
    """Reads and writes the files. A file is complete or missing."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def about(self) -> dict[str, Any] | None:
        """Contents of annotation.json; None if there is none. Raises SourceError if it cannot be read."""
        try:
            data = read_file(self.path / "annotation.json", "about")
        except FileNotFoundError:
            return None
        except OSError as error:
            raise SourceError(f"cannot read {self.path}: {error.strerror or error}") from None
        except FileTooLargeError as error:
            raise SourceError(f"{self.path}/annotation.json: {error}") from None
        try:
            about = read_object(data, largest("about") or 0)
        except JsonRefusedError:
            about = {}
        if about.get("format") != FORMAT or not isinstance(about.get("settings"), dict):
            raise SourceError(f"{self.path}/annotation.json does not describe an annotated drive")
        return about

    def begin(self, settings: Mapping[str, Any], sensor: SensorModel) -> None:
        """Continue the run in this folder, or begin one.

        Raises SettingsError if the existing run has other settings, SourceError if nothing can be written.
        """
        about = self.about()
        if about is not None:
            for name in sorted(settings.keys() | about["settings"].keys()):
                then, now = about["settings"].get(name), settings.get(name)
                if then != now and name == "made_of":
                    raise SettingsError(
                        f"{self.path} was begun with another calibration, capture or file of poses: use another folder"
                    )
                if then != now:
                    raise SettingsError(
                        f"{self.path} was begun with {name} = {then!r}, not {now!r}: use that value, or another folder"
                    )
            return
        if self.path.exists() and (not self.path.is_dir() or any(self.path.iterdir())):
            raise SettingsError(f"{self.path} has other files, and is not an annotated drive: use another folder")
        for name in ("frames", "labels"):
            _made(self.path / name)
        self._write_about({"format": FORMAT, "settings": dict(settings), "sensor": _told(sensor)})

    def note(self, **found: Any) -> None:
        """Add results to annotation.json."""
        self._write_about((self.about() or {}) | found)

    @property
    def sensor(self) -> SensorModel:
        """The sensor of the frames. Raises SourceError."""
        try:
            return _sensor_of((self.about() or {})["sensor"])
        except (KeyError, TypeError, ValueError, OverflowError, LidarCodecError):
            raise SourceError(f"{self.path}/annotation.json does not describe the sensor") from None

    @property
    def frames(self) -> int:
        """Number of frames. Raises SourceError unless all frames were written."""
        count = (self.about() or {}).get("frames")
        if not isinstance(count, int) or count < 1 or not self.has(f"frames/{count - 1:06d}.npz"):
            raise SourceError(
                f"the annotation of {self.path} is not finished: run the same `lidarcodec annotate` again"
            )
        return count

    def write_frame(self, index: int, frame: Frame) -> None:
        """Write a frame, with the stamp and times of its scan."""
        scan = scan_of(frame)
        told: dict[str, Any] = {"range": frame.range, "intensity": frame.intensity, "stamp_ns": np.int64(scan.stamp_ns)}
        if isinstance(rest := frame.side, PacketRest):
            told |= {"layout": np.frombuffer(rest.layout.encode(), np.uint8)}
            told |= {"packet_ns": rest.packet_ns[rest.regular] + (frame.stamp_ns - scan.stamp_ns)}
            told |= {_SERIES + name: numbers for name, numbers in rest.series.items()}
        else:
            columns = np.zeros(frame.width, np.float32)
            columns[np.nonzero(frame.valid.T)[0]] = scan.after_s
            told |= {"azimuth": frame.azimuth, "fired": frame.fired, "column_s": columns}
        self._save(f"frames/{index:06d}.npz", **told)

    def frame(self, index: int, sensor: SensorModel | None = None) -> Frame:
        """Read a frame, with the stamp of its scan. It has no side information; for sensors other than an HDL-64E, it
        has only what points need. Raises SourceError.
        """
        file = self._load(f"frames/{index:06d}.npz")
        sensor = self.sensor if sensor is None else sensor
        try:
            if not sensor.is_hdl64e:
                return image_frame(index, int(file["stamp_ns"]), {name: file[name] for name in (RANGE, INTENSITY)},
                                   _rest_of(file), sensor)  # fmt: skip
            return Frame(index, int(file["stamp_ns"]), file["range"], file["intensity"], file["azimuth"],
                         file["fired"], sensor)  # fmt: skip
        except (KeyError, TypeError, ValueError, OverflowError, AttributeError, LidarCodecError) as error:
            raise SourceError(f"{self.path}/frames/{index:06d}.npz has no frame: {error}") from None

    def scan(self, index: int, sensor: SensorModel | None = None) -> Scan:
        """The returns of a frame in the order of its cloud. Raises SourceError."""
        frame = self.frame(index, sensor)
        if not frame.sensor.is_hdl64e:
            return scan_of(frame)
        columns = self._load(f"frames/{index:06d}.npz")["column_s"]
        cloud = frame.cloud()
        points = np.stack([cloud[axis] for axis in "xyz"], axis=1)
        return Scan(frame.stamp_ns, points, columns[np.nonzero(frame.valid.T)[0]].astype(np.float32))

    def write_labels(self, index: int, found: Labels) -> None:
        """Write the labels of a frame."""
        self._save(
            f"labels/{index:06d}.npz", count=found.counts, label=found.labels, threshold=np.int64(found.threshold)
        )

    def labels(self, index: int) -> Labels:
        """Read the labels of a frame. Raises SourceError."""
        file = self._load(f"labels/{index:06d}.npz")
        try:
            found = Labels(file["count"], file["label"], int(file["threshold"]))
        except (KeyError, TypeError, ValueError, OverflowError):
            found = None
        if found is None or not _are_labels(found):
            raise SourceError(f"{self.path}/labels/{index:06d}.npz has no labels")
        return found

    def labelled(self) -> list[int]:
        """Numbers of the frames with a file of labels, in order. Raises SourceError."""
        count, names = self.frames, (self.path / "labels").glob("*.npz")
        numbers = {int(path.stem) for path in names if re.fullmatch(r"[0-9]{6,9}", path.stem, re.ASCII)}
        return sorted(number for number in numbers if number < count)

    def has(self, name: str) -> bool:
        """Whether a file, such as `labels/000003.npz`, exists."""
        return (self.path / name).exists()

    def write_map(self, points: npt.NDArray[np.float32], counts: npt.NDArray[np.uint16] | None) -> None:
        """Write the map. counts: None before counting"""
        counted = {} if counts is None else {"counts": counts}
        self._save("map.npz" if counted else "points.npz", points=points, **counted)

    def map_points(self) -> npt.NDArray[np.float32]:
        """(M, 3) float32. Raises SourceError."""
        points: npt.NDArray[np.float32] = self._load("points.npz")["points"]
        return points

    def map_counts(self) -> npt.NDArray[np.uint16]:
        """(M,) uint16. Raises SourceError."""
        counts: npt.NDArray[np.uint16] = self._load("map.npz")["counts"]
        return counts

    def trajectory(self) -> Trajectory:
        """The sensor's pose for each frame. Raises SourceError."""
        return Trajectory.load(self.path / "trajectory.npz")

    def write_trajectory(self, found: Trajectory) -> None:
        """Write the sensor's pose for each frame."""
        with written_whole(self.path / "trajectory.npz") as path:
            found.save(path)

    def write_part(self, first: int, counts: npt.NDArray[np.uint16]) -> None:
        """Write how often each point of the map was seen in a piece."""
        with written_whole(self.path / f"seen-{first:06d}.npy") as path:
            np.save(path, counts)

    def parts(self, piece: int) -> Iterator[Path]:
        """The existing files of `write_part`, one for each piece of `piece` frames."""
        names = (self.path / f"seen-{first:06d}.npy" for first in range(0, self.frames, piece))
        yield from (path for path in names if path.exists())

    def _save(self, name: str, **arrays: Any) -> None:
        with written_whole(self.path / name) as path:
            np.savez(path, **arrays)

    def _load(self, name: str) -> dict[str, Any]:
        try:
            return read_npz(self.path / name, most_bytes=largest("arrays") or 0)
        except (OSError, ArraysRefusedError) as error:
            raise SourceError(f"cannot read {self.path / name}: {error}") from None

    def _write_about(self, about: Mapping[str, Any]) -> None:
        with written_whole(self.path / "annotation.json") as path:
            path.write_text(json.dumps(about, indent=1) + "\n")


class Scans(Sequence[Scan]):
    """The scans of a folder, read when they are used."""

    def __init__(self, folder: AnnotationFolder) -> None:
        self._folder, self._sensor, self._count = folder, folder.sensor, folder.frames

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> Scan: ...
    @overload
    def __getitem__(self, index: slice) -> list[Scan]: ...
    def __getitem__(self, index: int | slice) -> Scan | list[Scan]:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        if not -self._count <= index < self._count:
            raise IndexError(index)
        return self._folder.scan(index % self._count, self._sensor)


def _told(sensor: SensorModel) -> dict[str, Any]:
    """A sensor as annotation.json describes it."""
    unit = {"name": sensor.name, "convention": sensor.convention, "table": sensor.calibration.table.tolist()}
    if sensor.is_hdl64e:
        return unit
    return unit | {
        "model": sensor.model,
        "range_step_m": sensor.range_step_m,
        "description": sensor.description.decode("latin-1"),
    }


def _sensor_of(unit: Mapping[str, Any]) -> SensorModel:
    """The inverse of `_told`. Raises KeyError, TypeError, ValueError, OverflowError, LidarCodecError."""
    calibration = Calibration(np.array(unit["table"], np.int32).reshape(len(CALIBRATION_FIELDS), -1))
    if "model" not in unit:
        return SensorModel(unit["name"], calibration, "given", unit["convention"])
    model, step_m, description = unit["model"], unit["range_step_m"], unit["description"]
    if not (isinstance(model, str) and isinstance(step_m, float) and 0 < step_m < 1 and isinstance(description, str)):
        raise ValueError("no sensor")
    data = description.encode("latin-1")
    sensor = SensorModel(unit["name"], calibration, "given", unit["convention"], step_m, model, data)
    if sensor.is_cloud or sensor_of(sensor) is None:
        raise ValueError("no sensor with images")
    return sensor


def _rest_of(file: Mapping[str, Any]) -> PacketRest:
    """What a file of a frame says of its packets, all of which are regular."""
    series = {name.removeprefix(_SERIES): file[name] for name in file if name.startswith(_SERIES)}
    layout = file["layout"].tobytes().decode("ascii")
    return PacketRest(layout, file["packet_ns"], np.zeros(0, np.uint16), (), series)


def _are_labels(found: Labels) -> bool:
    """Whether the arrays of a file are counts and labels of the same returns."""
    counts, labels, _ = found
    same = counts.shape == labels.shape and counts.ndim == 2
    whole = counts.dtype == np.uint16 and labels.dtype == np.uint8
    return same and whole and int(labels.max(initial=0)) < len(NAMES)


def _made(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SourceError(f"cannot make the folder {folder}: {error.strerror or error}") from None
