"""Scans of a KITTI folder: which files there are, their points, and when each turn of the sensor began and ended.

    2011_09_26_drive_0005_sync/velodyne_points/data/0000000000.bin ...    beside `data`: timestamps{,_start,_end}.txt
    sequences/00/velodyne/000000.bin ...                                  beside `velodyne`: times.txt

A file holds points of float32 x, y, z in metres and reflectance; `.bin.xz` is read as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.budgets import FileTooLargeError, read_file
from lidarcodec.errors import SourceError
from lidarcodec.sources.decompress import ByteStream

MAX_POINTS: Final = 1 << 20
"""Most points of a scan: eight times the returns of an HDL-64E in a turn."""
REVOLUTION_NS: Final = 103_400_000
"""Duration of a turn where a folder has no times: the mean of the KITTI drives."""
INVENTED_START_NS: Final = 1_317_038_400_000_000_000
"""Start where a folder has no times: 2011-09-26 12:00 UTC."""
FOLDERS: Final = ("", "velodyne_points/data", "velodyne", "data")
POINT_BYTES: Final = 16

Points = npt.NDArray[np.float64]
"""(N, 4): x forward, y left, z up in metres, reflectance 0..1."""


@dataclass(frozen=True)
class Scan:
    """One file, and the host times in ns at which its turn began and ended."""

    path: Path
    start_ns: int
    end_ns: int


def find_scans(path: Path) -> list[Scan]:
    """The scans of a folder (a drive, a sequence, or the folder of the files), in order; or the one scan of a file.

    Raises SourceError if there are none, or a file of times cannot be read.
    """
    files = [path] if path.exists() and not path.is_dir() else _files(path)
    times = _turns(files[0].parent.parent, [_number(file, k) for k, file in enumerate(files)])
    for file, (start, end) in zip(files, times, strict=True):
        if end < start:
            raise SourceError(f"{file}: the time stamps of this scan end before they begin")
    return [Scan(file, start, end) for file, (start, end) in zip(files, times, strict=True)]


def read_points(path: Path) -> tuple[Points, int]:
    """The points of a file, and the number of points left out because a value is not finite.

    Raises SourceError if it cannot be read, is cut within a point or too long.
    """
    stream = ByteStream(path)
    try:
        data = stream.read((MAX_POINTS + 1) * POINT_BYTES)
    finally:
        stream.close()
    if stream.problem:
        raise SourceError(f"{path}: {stream.problem}")
    if len(data) % POINT_BYTES or len(data) > MAX_POINTS * POINT_BYTES:
        raise SourceError(
            f"{path} is not a KITTI scan: its {len(data)} bytes are not 1 to {MAX_POINTS} points of 16 bytes"
        )
    points = np.frombuffer(data, "<f4").reshape(-1, 4)
    good = np.isfinite(points).all(axis=1) & (np.abs(points) < 1e4).all(axis=1)
    return points[good].astype(np.float64), int(np.count_nonzero(~good))


def is_millimetres(points: Points) -> bool:
    """Whether coordinates are whole millimetres: those of raw scans are, motion-compensated ones are not."""
    mm = points[:, :3] * 1000.0
    return bool(np.mean(np.abs(mm - np.rint(mm)) < 0.01) > 0.9) if len(points) else False


def _files(folder: Path) -> list[Path]:
    for name in FOLDERS:
        inner = folder / name
        if inner.is_dir():
            found = sorted(file for file in inner.iterdir() if file.name.endswith((".bin", ".bin.xz")))
            if found:  # .bin and .bin.xz of one name are the same scan
                return sorted({file.name.partition(".")[0]: file for file in reversed(found)}.values(), key=_place)
    raise SourceError(
        f"{folder} is neither a rosbag2 (no metadata.yaml) nor a KITTI folder (no *.bin, also not in "
        f"{', '.join(FOLDERS[1:])}){_captures_in(folder)}"
    )


def _captures_in(folder: Path) -> str:
    """Of a folder of captures, which one to name."""
    found = sorted(one.name for one in folder.iterdir() if one.suffix in (".pcap", ".pcapng", ".mcap"))
    return f"; a capture or recording is named itself, such as {folder / found[0]}" if found else ""


def _place(file: Path) -> tuple[int, str]:
    """Sort key: the number of the scan, also without leading zeros."""
    return _number(file, 0), file.name


def _number(file: Path, position: int) -> int:
    """The number of a scan in its drive. Times are found by it: scan files may be missing, lines of times are not."""
    stem = file.name.partition(".")[0]
    return int(stem) if stem.isdecimal() and len(stem) < 12 else position


def _turns(folder: Path, numbers: Sequence[int]) -> list[tuple[int, int]]:
    """Begin and end of each turn, from the files of times in the folder above the scans."""
    starts, ends = _stamps(folder / "timestamps_start.txt"), _stamps(folder / "timestamps_end.txt")
    if starts and ends:
        return [(_at(starts, n, folder), _at(ends, n, folder)) for n in numbers]
    middles = _stamps(folder / "timestamps.txt")
    if middles:
        halves = REVOLUTION_NS // 2
        return [(_at(middles, n, folder) - halves, _at(middles, n, folder) + halves) for n in numbers]
    times = _seconds(folder / "times.txt")
    if times:
        begins = [INVENTED_START_NS + _at(times, n, folder) for n in numbers]
    else:
        begins = [INVENTED_START_NS + (n - numbers[0]) * REVOLUTION_NS for n in numbers]
    return [(begin, begin + REVOLUTION_NS) for begin in begins]


def _at(stamps: list[int | None], number: int, folder: Path) -> int:
    stamp = stamps[number] if number < len(stamps) else None
    if stamp is None:
        raise SourceError(f"{folder}: scan {number} has no time stamp")
    return stamp


def _stamps(path: Path) -> list[int | None]:
    """Lines "2011-09-26 13:04:32.334529952" in ns; None for an empty line; no lines where there is no file."""
    return [None if not line.strip() else _nanoseconds(path, line.strip()) for line in _lines(path)]


def _nanoseconds(path: Path, text: str) -> int:
    try:
        stamp = np.datetime64(text.replace(" ", "T"), "ns")
        if np.isnat(stamp):
            raise ValueError("not a time")  # noqa: TRY301
        return int(stamp.astype(np.int64))
    except ValueError:
        raise SourceError(f"{path}: '{text[:40]}' is not a time: write it like 2011-09-26 13:04:32.334529952") from None


def _seconds(path: Path) -> list[int | None]:
    try:
        return [round(float(line) * 1e9) for line in _lines(path) if line.strip()]
    except (ValueError, OverflowError):
        raise SourceError(f"{path}: a line is not a number of seconds") from None


def _lines(path: Path) -> list[str]:
    try:
        return read_file(path, "stamps").decode().splitlines() if path.is_file() else []
    except (OSError, UnicodeDecodeError, FileTooLargeError) as error:
        raise SourceError(f"cannot read {path}: {error}") from None
