"""Points as PCD 0.7 of the Point Cloud Library, binary or compressed.

The format is described at https://pointclouds.org/documentation/tutorials/pcd_file_format.html. Fields are those of
PLY, with intensities as float32: PCL's PointXYZI takes only these, and reads 0 from any others. Compressed data are the
fields one behind the other, in LZF, after two sizes of 32 bits.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.commands.outputs.base import Cloud, Rows
from lidarcodec.errors import SettingsError
from lidarcodec.frame import Frame

COUNT_DIGITS: Final = 12
MOST_BYTES: Final = 2**32 - 1


def header_of(dtype: np.dtype[np.void], count: int, data: str) -> bytes:
    """The header, of the same length for every number of points: a comment is padded."""
    names = dtype.names or ()
    types = {"f": "F", "u": "U", "i": "I"}
    padding = "0" * (2 * (COUNT_DIGITS - len(str(count))))
    lines = (
        "# .PCD v0.7 - Point Cloud Data file format",
        f"# lidarcodec {padding}",
        "VERSION 0.7",
        f"FIELDS {' '.join(names)}",
        f"SIZE {' '.join(str(dtype[name].itemsize) for name in names)}",
        f"TYPE {' '.join(types[dtype[name].kind] for name in names)}",
        f"COUNT {' '.join('1' for _ in names)}",
        f"WIDTH {count}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {count}",
        f"DATA {data}",
    )
    return ("\n".join(lines) + "\n").encode()


class PcdOutput:
    """Binary PCD: x y z in metres, intensity as the sensor counts it, laser, ring, frame, and t in seconds since the
    first point."""

    def __init__(self, path: Path) -> None:
        self._handle = path.open("wb")
        self._rows = Rows(".pcd", real=True)
        self._begun = False
        self._count = 0

    def write(self, frame: Frame, cloud: Cloud) -> None:
        rows = self._rows.of(frame, cloud)
        if not self._begun:
            self._begun = True
            self._handle.write(header_of(self._rows.dtype, 0, "binary"))
        self._handle.write(rows.tobytes())
        self._count += len(rows)

    def close(self) -> None:
        self._handle.seek(0)
        self._handle.write(header_of(self._rows.dtype, self._count, "binary"))
        self._handle.close()


class CompressedPcdOutput:
    """Compressed PCD with the same fields. All points stay in memory until the end, as the format has one block."""

    def __init__(self, path: Path) -> None:
        self._handle = path.open("wb")
        self._rows = Rows(".pcd", real=True)
        self._parts: list[npt.NDArray[np.void]] = []
        self._bytes = 0

    def write(self, frame: Frame, cloud: Cloud) -> None:
        rows = self._rows.of(frame, cloud)
        self._bytes += rows.nbytes
        if self._bytes > MOST_BYTES:
            raise SettingsError("a compressed .pcd holds at most 4 GiB of points: write fewer frames, or a folder")
        self._parts.append(rows)

    def close(self) -> None:
        from imagecodecs import lzf_encode

        rows = np.concatenate([np.empty(0, self._rows.dtype), *self._parts])
        plain = b"".join(np.ascontiguousarray(rows[name]).tobytes() for name in rows.dtype.names or ())
        # LZF makes data that it cannot compress longer by a 32nd at most.
        packed = lzf_encode(plain, out=len(plain) + len(plain) // 16 + 64) if plain else b""
        self._handle.write(header_of(rows.dtype, len(rows), "binary_compressed"))
        self._handle.write(struct.pack("<II", len(packed), len(plain)) + packed)
        self._handle.close()
