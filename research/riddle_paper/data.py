"""Frames to train and to measure on: whole turns, each with the motion since the one before it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.motion.finder import MotionFinder
from lidarcodec.motion.motion import Motion
from lidarcodec.motion.warp import RangeHistory
from lidarcodec.pipeline import frames_of
from lidarcodec.sources import open_source
from research.riddle_paper.context import ContextReader, Contexts, nearest_anchor
from research.riddle_paper.images import PaperImage, image_of, ranges_of
from research.riddle_paper.moved import MovedPoints

LEAST_COLUMNS = 1000
"""A frame with fewer is the beginning or end of a capture, not a turn."""


@dataclass(frozen=True, eq=False)
class Scan:
    """A turn, the one before it, and how the sensor moved in between; both None where that is not known."""

    frame: Frame
    earlier: Frame | None = None
    motion: Motion | None = None

    def points(self, step: int, count: int) -> MovedPoints | None:
        """What a decoder has of the scan before, in steps of `step` x 2 mm; None where there is none, or count is 0."""
        if self.earlier is None or self.motion is None or not count:
            return None
        sent = ranges_of(image_of(self.earlier, step), self.earlier)
        return MovedPoints(self.earlier, sent, self.motion, count)


def scans_of(frames: Iterable[Frame]) -> Iterator[Scan]:
    """Scans of a run of turns. The motion is found as `predictive` finds it, from poses where frames have them."""
    finder, seen = MotionFinder(), RangeHistory()
    before: Frame | None = None
    for frame in frames:
        if frame.width < LEAST_COLUMNS:
            before = None
            continue
        found = finder.next(frame, seen)
        seen.remember(frame.range_u16, frame.azimuth, frame.fired, frame.sensor)
        known = before is not None and found.origin in ("found", "poses")
        yield Scan(frame, before, found.motion) if known else Scan(frame)
        before = frame


def read_scans(
    source: str, *, calibration: Path | None = None, skip: int = 0, every: int = 1, most: int | None = None
) -> list[Scan]:
    """Scans of a capture or any other source: each `every`th after the first `skip`, at most `most`.

    Raises SourceError, CalibrationError or PacketError when the source cannot be read.
    """
    with open_source(source, calibration=calibration) as opened:
        scans = scans_of(frames_of(opened.packets(), opened.sensor, "revolution"))
        return list(islice(scans, skip, None if most is None else skip + (most - 1) * every + 1, every))


@dataclass(frozen=True, eq=False)
class Samples:
    """N returns to learn from: contexts, and the right answers.

    ranges_m: (N,) float32 metres, quantised; anchor: (N,) number of the right anchor; step: of the image
    """

    contexts: Contexts
    ranges_m: np.ndarray[tuple[int], np.dtype[np.float32]]
    anchor: np.ndarray[tuple[int], np.dtype[np.intp]]
    step: int


class Prepared:
    """An image, ready for returns to be drawn from it."""

    def __init__(self, image: PaperImage, earlier: MovedPoints | None) -> None:
        self.image, self.reader = image, ContextReader(image, earlier)
        self.places = np.flatnonzero(image.valid).astype(np.uint32)

    def samples(self, count: int, rng: np.random.Generator) -> Samples:
        """Up to `count` returns, drawn at random; those without any valid neighbour are left out."""
        places = self.places
        if len(places) > count:
            places = places[np.sort(rng.choice(len(places), count, replace=False))]
        rows, columns = np.divmod(places.astype(np.intp), self.image.cells.shape[1])
        contexts = self.reader.read(rows, columns)
        ranges = self.image.cells[rows, columns].astype(np.float32) * np.float32(self.image.step_m)
        anchor, any_valid = nearest_anchor(contexts, ranges)
        kept = np.flatnonzero(any_valid)
        chosen = Contexts(
            contexts.features[kept], contexts.valid[kept], contexts.anchors_m[kept], contexts.before_m[kept]
        )  # fmt: skip
        return Samples(chosen, ranges[kept], anchor[kept], self.image.step)


class PreparedScans:
    """Images of scans in some steps. The last `most` are kept: making one takes as long as learning from 40 returns."""

    def __init__(self, scans: Sequence[Scan], temporal: int, most: int = 400) -> None:
        self._scans, self._temporal = scans, temporal
        self._prepared = lru_cache(most)(self._prepare)

    def _prepare(self, number: int, step: int) -> Prepared:
        scan = self._scans[number]
        return Prepared(image_of(scan.frame, step), scan.points(step, self._temporal))

    def batch(self, quanta: Sequence[int], count: int, frames: int, rng: np.random.Generator) -> list[Samples]:
        """About `count` returns of `frames` scans drawn at random, each in a step drawn from `quanta`."""
        parts = []
        for number in rng.choice(len(self._scans), frames, replace=len(self._scans) < frames):
            step = int(rng.choice(np.asarray(quanta)))
            parts.append(self._prepared(int(number), step).samples(count // frames, rng))
        return parts
