"""Examples for the detector: clouds with boxes, of simulated drives and of labelled ones."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.evaluation.detection.boxes import Boxes, joined
from lidarcodec.evaluation.detection.detector.network import KINDS
from lidarcodec.evaluation.detection.detector.precision import KIND_OF
from lidarcodec.evaluation.detection.detector.view import Floats
from lidarcodec.evaluation.detection.labels import Labels
from lidarcodec.evaluation.detection.truth import boxes_of
from lidarcodec.pipeline import frames_of
from lidarcodec.sources import open_source
from lidarcodec.sources.drive import SimulatedDrive

REACH_M: Final = 55.0
HIGHEST_M: Final = 1.5
FEWEST: Final = 20
MARGIN_M: Final = 0.1


class Example(NamedTuple):
    """points: (N, 3) float32 metres; intensity: (N,) uint8; boxes: (M, 7) middle, size and angle; kind: (M,) index into
    KINDS, or -1 for what is neither to be found nor to be left out; whole: whether all directions are labelled"""

    points: Floats
    intensity: npt.NDArray[np.uint8]
    boxes: Floats
    kind: npt.NDArray[np.int64]
    whole: bool


def examples_of(
    spec: str | Path, labels: Labels | None = None, *, first_label: int = 0, frames: int | None = None,
    calibration: Path | None = None,
) -> Iterator[Example]:  # fmt: skip
    """The frames of a drive, 1 MB each. labels: None for a simulated drive, whose boxes are known

    Raises SourceError.
    """
    with open_source(spec, calibration=calibration) as source:
        turns = enumerate(frames_of(source.packets(), source.sensor, "revolution"), first_label)
        for number, frame in islice(turns, frames):
            cloud = frame.cloud()
            if labels is None and isinstance(source, SimulatedDrive):
                yield _example(cloud, boxes_of(source, cloud), True)
            elif labels is not None and number in labels:
                yield _example(cloud, labels.get(number, joined(())), False)


def _example(cloud: npt.NDArray[np.void], boxes: Boxes, whole: bool) -> Example:
    points = np.stack([cloud[name] for name in "xyz"], axis=-1).astype(np.float32)
    near = (np.abs(points[:, :2]).max(axis=1) < REACH_M) & (points[:, 2] < HIGHEST_M)
    points = points[near]
    yaw = np.arctan2(boxes.axes[:, 0, 1], boxes.axes[:, 0, 0])
    kind = np.array([_number(name) for name in boxes.kinds], np.int64)
    for at in range(len(boxes)):
        inside = np.abs(boxes.within(at, points)) <= boxes.size[at] / 2 + MARGIN_M
        if np.count_nonzero(inside.all(axis=1)) < FEWEST:
            kind[at] = -1
    rows = np.concatenate([boxes.middle, boxes.size, yaw[:, None]], axis=1).astype(np.float32)
    return Example(points, cloud["intensity"][near].astype(np.uint8), rows, kind, whole)


def _number(label: str) -> int:
    kind = KIND_OF.get(label)
    return -1 if kind is None else KINDS.index(kind)
