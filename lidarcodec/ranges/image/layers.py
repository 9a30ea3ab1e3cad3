"""Layers: the columns of several frames, turn by turn, as one image in which the rows of a laser are its turns.

Columns keep their order and go round like a helix: position p lies in turn p // T of the group, at column p % T, where
T columns make a turn. So a laser's rows look in the same direction column by column, whether frames are whole turns or
not. The image has H rows for each laser, H a multiple of 8: a block of a JPEG never mixes two lasers.

>>> layout = layers_of([np.arange(0, 36000, 18, np.uint16)] * 2)
>>> layout.turn, layout.starts, layout.height
(2000, (0, 2000), 8)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError
from lidarcodec.ranges.image.jpeg_file import BLOCK
from lidarcodec.units import AZIMUTH_TURN, LASERS, MAX_COLUMNS

Pixel = TypeVar("Pixel", bound=np.generic)

MAX_SAMPLES: Final = 1 << 24
"""Samples in the image of a group, at most: it limits the memory of a decoder."""
_LONGEST_TURN: Final = 8192
"""More columns are not a turn: the sensor stands still, or its azimuths are noise."""
_TOLERANCE: Final = 64
"""Columns by which a frame may seem to begin before the last one ended."""


def whole_blocks(count: int) -> int:
    """The next multiple of 8."""
    return -(-count // BLOCK) * BLOCK


@dataclass(frozen=True)
class Layers:
    """Where the columns of a group lie.

    turn: columns of a turn; starts: position of each frame's first column; widths: columns of each frame
    lasers: rows of a frame
    """

    turn: int
    starts: tuple[int, ...]
    widths: tuple[int, ...]
    lasers: int = LASERS

    def __post_init__(self) -> None:
        end = 0
        for start, width in zip(self.starts, self.widths, strict=True):
            if start < end:
                raise SectionError(f"a frame that begins at column {start} of its group, before {end}")
            end = start + width
        if not 0 <= self.turn <= MAX_COLUMNS or (end and not self.turn):
            raise SectionError(f"{end} columns in turns of {self.turn}")
        if self.samples > MAX_SAMPLES:
            raise SectionError(f"a group of {self.samples} samples: {MAX_SAMPLES} are possible")

    @property
    def height(self) -> int:
        """Rows of each laser."""
        end = self.starts[-1] + self.widths[-1]
        return whole_blocks(-(-end // self.turn)) if end else 0

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""
        return self.lasers * self.height, whole_blocks(self.turn)

    @property
    def samples(self) -> int:
        """Number of samples in the image."""
        return self.shape[0] * self.shape[1]

    def _runs(self, frame: int) -> Iterator[tuple[int, int, int, int]]:
        """Turn, column in it, first column of the frame, number of columns: for each turn that the frame touches."""
        at = 0
        while at < self.widths[frame]:
            turn, column = divmod(self.starts[frame] + at, self.turn)
            count = min(self.turn - column, self.widths[frame] - at)
            yield turn, column, at, count
            at += count

    def spread(self, images: Sequence[npt.NDArray[Pixel]]) -> npt.NDArray[Pixel]:
        """The image of the group's frames, (H, W) each; zeros where there is none."""
        rows, width = self.shape
        out = np.zeros((self.lasers, self.height, width), images[0].dtype)
        for frame, image in enumerate(images):
            for turn, column, at, count in self._runs(frame):
                out[:, turn, column : column + count] = image[:, at : at + count]
        return out.reshape(rows, width)

    def gather(self, image: npt.NDArray[Pixel]) -> list[npt.NDArray[Pixel]]:
        """The frames out of an image of this shape."""
        layers = image.reshape(self.lasers, self.height, self.shape[1])
        frames = []
        for frame, width in enumerate(self.widths):
            out = np.zeros((self.lasers, width), image.dtype)
            for turn, column, at, count in self._runs(frame):
                out[:, at : at + count] = layers[:, turn, column : column + count]
            frames.append(out)
        return frames


def _one_row_each(widths: tuple[int, ...], lasers: int) -> Layers:
    widest = max(widths)
    return Layers(widest, tuple(frame * widest for frame in range(len(widths))), widths, lasers)


def group_fits(frames: int, widest: int, lasers: int = LASERS) -> bool:
    """Whether so many frames of at most that width can be one group. lasers: rows of a frame"""
    return lasers * whole_blocks(frames) * whole_blocks(widest) <= MAX_SAMPLES


def layers_of(azimuths: Sequence[npt.NDArray[np.uint16]], lasers: int = LASERS) -> Layers:
    """Layout of a group of frames with these azimuths, (W,) each, 0.01 degree. `group_fits` must hold.

    lasers: rows of a frame

    Each frame begins at its first azimuth, so a faster turn or lost packets do not shift the frames after it.
    """
    widths = tuple(len(azimuth) for azimuth in azimuths)
    turns = []
    for azimuth in azimuths:
        angles = azimuth.astype(np.int64)
        travel = int(((angles[1:] - angles[:-1]) % AZIMUTH_TURN).sum())
        turns.append(-(-AZIMUTH_TURN * (len(azimuth) - 1) // travel) if travel > 0 else 0)
    turn = max(*turns, *widths)
    if not 0 < turn <= _LONGEST_TURN:
        return _one_row_each(widths, lasers)
    starts = [0]
    for last, azimuth in pairwise(azimuths):
        end = starts[-1] + len(last)
        if not len(azimuth) or not len(last):
            starts.append(end)
            continue
        further = (int(azimuth[0]) - int(last[0])) % AZIMUTH_TURN * turn // AZIMUTH_TURN
        begin = starts[-1] + further
        begin += max(0, -(-(end - _TOLERANCE - begin) // turn)) * turn
        starts.append(max(begin, end))
    end = starts[-1] + widths[-1]
    if whole_blocks(-(-end // turn)) > whole_blocks(len(widths)):
        return _one_row_each(widths, lasers)
    return Layers(turn, tuple(starts), widths, lasers)
