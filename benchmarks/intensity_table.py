"""Prints, as Markdown, what intensities of few values cost and how far off they are, drive by drive.

    python -m benchmarks.intensity_table [--frames 6] [--save]

Drives 0013, `sfnd`, 0001 and 0005, frames spread evenly over 54 revolutions of each. Bits are those of the section, a
return; errors are of 255. Beside `levels=N` stands what N evenly spaced values take that each return is rounded to.
--save writes benchmarks/results/intensity.csv.
"""

from __future__ import annotations

import argparse
import time
from itertools import islice
from typing import Final

import numpy as np
import numpy.typing as npt

from benchmarks import results
from benchmarks.scenes import DATA
from lidarcodec import api, entropy
from lidarcodec.frame import Frame
from lidarcodec.planes.intensity import Quality, encode_intensity
from lidarcodec.planes.sections import fired_cells
from lidarcodec.settings import StreamSettings
from tests.planes.one_section import read_intensity

DRIVES: Final = {
    "0013": "kitti_0013_f052-107.pcap.xz",
    "sfnd": "kitti_sfnd_f000-049.pcap.xz",
    "0001": "kitti_0001_f000-089.pcap.xz",
    "0005": "kitti_0005.pcap.xz",
}
CHOICES: Final = (
    *(f"levels={levels}" for levels in (2, 3, 4, 5, 6, 8, 10, 12, 14, 16, 20, 24, 32, 48, 64)),
    *(f"error={error}" for error in (1, 2, 4, 8, 16, 32)),
    "lossless",
)
READ: Final = 56
"""Revolutions of a drive that frames are taken from."""


def frames_of(drive: str, count: int) -> list[Frame]:
    """So many frames of a drive, spread evenly."""
    every = list(islice(api.read_frames(str(DATA / DRIVES[drive]), framing="revolution"), 1, READ - 1))
    return every[:: max(len(every) // count, 1)][:count]


def evenly(frame: Frame, levels: int) -> npt.NDArray[np.uint8]:
    """(64, W) uint8, each intensity as the nearest of evenly spaced values."""
    number = (frame.intensity.astype(np.uint32) * (levels - 1) + 127) // 255
    return ((number * 255 + (levels - 1) // 2) // (levels - 1)).astype(np.uint8)


class Sums:
    """What came of frames: bits a return, root of the mean square and largest of errors, ms of the quickest."""

    def __init__(self) -> None:
        self._bits = self._squares = self._returns = 0
        self.largest = 0
        self.ms = np.inf

    def add(self, frame: Frame, image: npt.NDArray[np.uint8], data: bytes, seconds: float) -> None:
        """One frame, what it decodes to, its bytes, and how long they took to make."""
        valid = frame.valid
        off = image[valid].astype(np.int64) - frame.intensity[valid]
        self._bits += 8 * len(data)
        self._squares += int(np.dot(off, off))
        self._returns += len(off)
        self.largest = max(self.largest, int(np.abs(off).max(initial=0)))
        self.ms = min(self.ms, 1e3 * seconds)

    def __str__(self) -> str:
        returns = max(self._returns, 1)
        return f"{self._bits / returns:.3f} / {np.sqrt(self._squares / returns):.2f}"


def measured(frames: list[Frame], choice: str, *, grouped: bool = False) -> Sums:
    """What a setting of `intensity` makes of frames; each is decoded."""
    sums, quality = Sums(), Quality.of(StreamSettings(intensity=choice))
    for frame in frames:
        cells, turn = fired_cells(frame.fired, frame.sensor), entropy.columns_in_turn(frame.azimuth)
        begin = time.process_time()
        data = encode_intensity(frame, cells, quality, turn=turn, grouped=grouped) or b""
        seconds = time.process_time() - begin
        sums.add(frame, read_intensity(data, frame.valid, frame.fired, frame.sensor), data, seconds)
    return sums


def measured_evenly(frames: list[Frame], levels: int) -> Sums:
    """What evenly spaced values make of them."""
    sums = Sums()
    for frame in frames:
        image, turn = evenly(frame, levels), entropy.columns_in_turn(frame.azimuth)
        sums.add(frame, image, entropy.encode_intensity(image, frame.valid, frame.fired, frame.sensor, turn=turn), 0.0)
    return sums


def table_of(count: int) -> str:
    """The table."""
    drives = {name: frames_of(name, count) for name in DRIVES}
    lines = [
        f"| `intensity` | {' | '.join(DRIVES)} | 0005, evenly spaced | 0005, `zstd` | largest error, 0005 | ms, 0005 |",
        "|---|" + "---|" * (len(DRIVES) + 4),
    ]
    for choice in CHOICES:
        cells = {name: measured(frames, choice) for name, frames in drives.items()}
        name, _, number = choice.partition("=")
        even = str(measured_evenly(drives["0005"], int(number))) if name == "levels" else "-"
        of_test = cells["0005"]
        parts = [*map(str, cells.values()), even, str(measured(drives["0005"], choice, grouped=True))]
        lines.append(f"| `{choice}` | {' | '.join(parts)} | {of_test.largest} | {of_test.ms:.1f} |")
    return "\n".join(lines)


def main() -> None:
    """Print the table, and with --save keep it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=6, help="frames of each drive")
    parser.add_argument("--save", action="store_true", help="into benchmarks/results/intensity.csv")
    given = parser.parse_args()
    text = table_of(given.frames)
    print(text)
    if given.save:
        results.save("intensity", text, title="Bits a return / RMSE, of 255")


if __name__ == "__main__":
    main()
