"""What is left of labelled objects in decoded frames: one drive, every setting.

read the drive -> boxes of each frame -> ground and clusters of the original frames -> for every setting: encode,
decode, ground and clusters again -> scores, and their differences from the original ones
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

import lidarcodec
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.evaluation.bench import effective
from lidarcodec.evaluation.detection.boxes import Boxes, joined
from lidarcodec.evaluation.detection.detector.network import Network
from lidarcodec.evaluation.detection.detector.objects import NONE, Found, found_in
from lidarcodec.evaluation.detection.detector.precision import Precision, precisions
from lidarcodec.evaluation.detection.labels import Labels
from lidarcodec.evaluation.detection.objects import Objects, objects_in
from lidarcodec.evaluation.detection.scores import FEWEST_RETURNS, Tally, scores
from lidarcodec.evaluation.detection.segments import Segments, Surfaces, ground_overlap, segments_of, surfaces_of
from lidarcodec.evaluation.detection.truth import boxes_of
from lidarcodec.evaluation.localisation.coding import received
from lidarcodec.evaluation.recorded import RecordedFrames
from lidarcodec.filling import measured_only
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.pipeline import frames_of
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from lidarcodec.sources.drive import SimulatedDrive
from lidarcodec.sources.posed import posed
from lidarcodec.sources.unkept import say_unkept
from lidarcodec.wire import pack

AHEAD: Final = 1
AROUND: Final = 5
"""Sectors that the detector looks at: KITTI's labels are those of a camera that looks ahead."""
TURN_S: Final = 0.1
"""Time of a frame, where there is only one."""
SHORTEST_S: Final = 0.001
STRANGE: Final = 1000
"""A frame is of another drive if more than one of so many returns is where the original has none."""
Result = dict[str, Any]
Tick = Callable[[], None]
NOTHING: Final = Segments(
    np.zeros((0, 3), np.float32), np.zeros(0, np.intp), np.zeros(0, np.bool_), np.zeros(0, np.int32)
)
"""The parts of a frame that did not arrive."""


@dataclass(frozen=True)
class Labelled:
    """A frame with its boxes, and what was measured in it. counted: (N,) which boxes are counted"""

    frame: Frame
    boxes: Boxes
    surfaces: Surfaces
    objects: Objects
    counted: npt.NDArray[np.bool_]


@dataclass
class _Sent:
    """Bytes and returns of the frames that arrived."""

    bytes: int = 0
    points: int = 0
    tallies: dict[int, tuple[Objects, tuple[int, int]]] = field(default_factory=dict)
    boxes: dict[int, Found] = field(default_factory=dict)


class Detection:
    """One drive with its boxes. It needs 1 MB of memory for each frame.

    labels: boxes by the number of their frame; None for a simulated drive, whose boxes are known
    first_label: number of the labels of the source's first frame; tick: called after each frame, can be changed
    detector: network whose average precision is measured, too
    Raises SourceError if the source cannot be used, or has no labelled frame, SettingsError if labels are missing.
    """

    def __init__(
        self,
        spec: str | Path,
        labels: Labels | None,
        *,
        first_label: int = 0,
        frames: int | None = None,
        skip: int = 0,
        calibration: Path | None = None,
        poses: Path | None = None,
        seed: int = 1,
        detector: Network | None = None,
        tick: Tick = lambda: None,
    ) -> None:
        self.name, self._seed, self.tick = str(spec), seed, tick
        self._detector, self._sectors = detector, AROUND if labels is None else AHEAD
        self._labels = "labels" if labels is not None else "simulated"
        self.frames: list[Labelled] = []
        with open_source(spec, calibration=calibration, poses=poses) as source:
            if labels is None and not isinstance(source, SimulatedDrive):
                raise SettingsError(f"{spec} has no labels: give them with --labels FILE", "labels")
            numbered = enumerate(frames_of(source.packets(), source.sensor, "revolution"), first_label)
            for number, frame in islice(numbered, skip, None if frames is None else skip + frames):
                if isinstance(source, SimulatedDrive) and labels is None:
                    boxes = boxes_of(source, frame.cloud())
                else:
                    boxes = (labels or {}).get(number, joined(()))
                self.frames.append(_labelled(posed(frame, source.poses if poses else None), boxes))
                tick()
            say_unkept(self.name, source.counts)
        if not any(len(one.boxes) for one in self.frames):
            missing = "no vehicle or person" if labels is None else "no frame with a label: see --first-label"
            raise SourceError(f"{spec} has {missing}")
        self.tally = Tally()
        for one in self.frames:
            ground = int(np.count_nonzero(one.surfaces == 2))
            self.tally.add(one.boxes, one.objects, one.counted, (ground, ground))
        self.precision = self._precision_of({at: self._found(one.frame) for at, one in enumerate(self.frames)})

    def original(self) -> Result:
        """Scores of the original frames."""
        points = sum(one.frame.points for one in self.frames)
        about = {"source": self.name, "codec": "original", "settings": {}}
        about |= self._about(len(self.frames), points, None) | scores(self.tally, self.tally, self._seed)
        return about | self._detected(self.precision)

    def setting(self, settings: StreamSettings) -> Result:
        """Scores of the frames as they come back, coded with these settings.

        Raises DecodeError if a codec cannot decode its own messages, SettingsError, UnknownNameError.
        """
        about, tally, precision = self.measured(settings)
        return about | scores(tally, self.tally, self._seed) | self._detected(precision)

    def measured(self, settings: StreamSettings) -> tuple[Result, Tally, Precision]:
        """What `setting` says about codec and bitrate, and what was measured in each frame.

        Raises DecodeError if a codec cannot decode its own messages, SettingsError, UnknownNameError.
        """
        sent = _Sent()

        def show(at: int, frame: Frame) -> None:
            self._measure(sent, at, frame)

        coded = received([one.frame for one in self.frames], settings, (), tick=self.tick, show=show)
        sent.bytes = sum(coded.sizes)
        about = {"source": self.name, "codec": settings.codec, "settings": effective(settings)}
        about |= self._about(len(sent.tallies), sent.points, sent.bytes)
        return about, self._tally_of(sent), self._precision_of(sent.boxes)

    def recording(self, path: Path) -> Result:
        """Scores of the frames in a recording of this drive.

        Raises SourceError if it has no frame of this drive, frames of another one, or cannot be read.
        """
        recorded, sent = RecordedFrames(path), _Sent()
        known = recorded.settings()
        places = {one.frame.stamp_ns: at for at, one in enumerate(self.frames)}
        message: Message | None = None
        for frame in recorded:
            at = places.pop(frame.stamp_ns, None)
            if at is None:
                continue
            if not _came_of(self.frames[at].frame, frame):
                raise SourceError(
                    f"frame {frame.index} of {path} has other returns than the frame of that time of {self.name}: "
                    "the recording was not made from this source"
                )
            self._measure(sent, at, frame)
            if recorded.message is not None and recorded.message is not message:
                message = recorded.message
                sent.bytes += len(pack(message))
                if recorded.refined is not None:
                    sent.bytes += recorded.refined.coded_bytes
            self.tick()
        if not sent.tallies:
            raise SourceError(
                f"no frame of {path} has the time of a frame of {self.name}: the recording was "
                "not made from this source"
            )
        about = {
            "source": self.name,
            "recording": str(path),
            "codec": "recording" if known is None else known.codec,
            "settings": {} if known is None else effective(known),
            "failed": sum(recorded.failed.values()),
        }
        sizes = self._about(len(sent.tallies), sent.points, sent.bytes if message is not None else None)
        found = scores(self._tally_of(sent), self.tally, self._seed)
        return about | sizes | found | self._detected(self._precision_of(sent.boxes))

    def _measure(self, sent: _Sent, at: int, frame: Frame) -> None:
        one, parts = self.frames[at], segments_of(frame)
        sent.points += len(parts.points)
        sent.tallies[at] = objects_in(one.boxes, parts, one.counted), ground_overlap(one.surfaces, parts)
        sent.boxes[at] = self._found(frame)

    def _found(self, frame: Frame) -> Found:
        if self._detector is None:
            return NONE
        cloud = measured_only(frame).cloud()
        points = np.stack([cloud[name] for name in "xyz"], axis=-1)
        return found_in(self._detector, points, cloud["intensity"], self._sectors)

    def _precision_of(self, boxes: dict[int, Found]) -> Precision:
        precision = Precision()
        for at, one in enumerate(self.frames):
            precision.add(at, boxes.get(at, NONE), one.boxes, one.counted, self._sectors)
        return precision

    def _detected(self, precision: Precision) -> Result:
        if self._detector is None:
            return {}
        return {"detector": precisions(precision, self.precision, self._seed)}

    def _tally_of(self, sent: _Sent) -> Tally:
        tally = Tally()
        for at, one in enumerate(self.frames):
            objects, ground = sent.tallies.get(at) or (objects_in(one.boxes, NOTHING), (0, 0))
            tally.add(one.boxes, objects, one.counted, ground)
        return tally

    def _about(self, arrived: int, points: int, size: int | None) -> Result:
        frames = len(self.frames)
        stamps = np.diff([one.frame.stamp_ns for one in self.frames])
        turn_s = max(float(np.median(stamps)) * 1e-9, SHORTEST_S) if frames > 1 else TURN_S
        return {
            "labels": self._labels,
            "frames": frames,
            "frames_left_out": frames - arrived,
            "fewest_returns": FEWEST_RETURNS,
            "points_per_frame": round(points / frames, 1),
            "bytes_per_frame": None if size is None else round(size / frames, 1),
            "kbps": None if size is None else round(size / frames * 8 / turn_s / 1000, 1),
            "version": lidarcodec.__version__,
        }


def _came_of(original: Frame, decoded: Frame) -> bool:
    """Whether a decoded frame can be of this one: no codec has a measured return where there was none."""
    if decoded.sensor.model != original.sensor.model:
        return False
    if decoded.sensor.is_cloud or decoded.range.shape != original.range.shape:  # a part of a frame, or moved points
        return True
    there = measured_only(decoded).range > 0
    return int(np.count_nonzero(there & (original.range == 0))) * STRANGE <= int(np.count_nonzero(there))


def _labelled(frame: Frame, boxes: Boxes) -> Labelled:
    parts = segments_of(frame)
    objects = objects_in(boxes, parts)
    return Labelled(frame, boxes, surfaces_of(parts), objects, objects.returns >= FEWEST_RETURNS)
