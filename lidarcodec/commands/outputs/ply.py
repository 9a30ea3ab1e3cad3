"""Points as binary PLY."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from lidarcodec.commands.outputs.base import Cloud, Rows
from lidarcodec.frame import Frame


class PlyOutput:
    """Binary PLY: x y z in metres, intensity (16 bits if the sensor sends 16, and of point clouds), laser, ring, frame,
    and t in seconds since the first point."""

    TYPE_NAMES: Final = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "i4": "int"}
    COUNT_DIGITS: Final = 12

    def __init__(self, path: Path) -> None:
        self._handle = path.open("wb")
        self._rows = Rows(".ply")
        self._begun = False
        self._count = 0

    def _write_header(self) -> None:
        # The number of points is known only at the end. It then overwrites the first number; both are padded to one
        # length.
        dtype = self._rows.dtype
        properties = "".join(f"property {self.TYPE_NAMES[dtype[name].str[1:]]} {name}\n" for name in dtype.names or ())
        padding = "0" * (self.COUNT_DIGITS - len(str(self._count)))
        self._handle.write(
            f"ply\nformat binary_little_endian 1.0\ncomment lidarcodec {padding}\n"
            f"element vertex {self._count}\n{properties}end_header\n".encode()
        )

    def write(self, frame: Frame, cloud: Cloud) -> None:
        rows = self._rows.of(frame, cloud)
        if not self._begun:
            self._begun = True
            self._write_header()
        self._handle.write(rows.tobytes())
        self._count += len(rows)

    def close(self) -> None:
        self._handle.seek(0)
        self._write_header()
        self._handle.close()
