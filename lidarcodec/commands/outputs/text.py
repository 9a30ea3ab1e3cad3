"""Points as text, a line each (.csv)."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from lidarcodec.commands.outputs.base import Cloud
from lidarcodec.frame import Frame


class CsvOutput:
    """A line of names, then a line for each point: x y z in metres to the tenth of a millimetre, all further fields of
    the cloud as whole numbers, frame, and time in ns since 1970. Other frames have the fields of the first one."""

    COORDINATES: Final = ("x", "y", "z")

    def __init__(self, path: Path) -> None:
        self._handle = path.open("w", encoding="ascii", newline="\n")
        self._fields: tuple[str, ...] | None = None

    def write(self, frame: Frame, cloud: Cloud) -> None:
        if self._fields is None:
            self._fields = tuple(name for name in cloud.dtype.names or () if name not in ("x", "y", "z", "t_ns"))
            self._handle.write(",".join((*(f"{axis}_m" for axis in "xyz"), *self._fields, "frame", "t_ns")) + "\n")
        columns = [np.char.mod("%.4f", cloud[axis].astype(np.float64)) for axis in self.COORDINATES]
        names = cloud.dtype.names or ()
        for name in self._fields:
            values = cloud[name] if name in names else np.zeros(len(cloud), np.uint8)
            columns.append(np.char.mod("%g" if values.dtype.kind == "f" else "%d", values))
        columns.append(np.full(len(cloud), str(frame.index)))
        columns.append(np.char.mod("%d", cloud["t_ns"]))
        self._handle.writelines(",".join(row) + "\n" for row in zip(*(one.tolist() for one in columns), strict=True))

    def close(self) -> None:
        self._handle.close()
