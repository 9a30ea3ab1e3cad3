"""Points as E57 (ASTM E2807), by pye57."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import numpy as np

from lidarcodec.commands.outputs.base import Cloud
from lidarcodec.files.whole import made_anew
from lidarcodec.frame import Frame


class E57Output:
    """A scan for each frame, with its number as name: x y z in metres, intensity as the sensor sends it, and the ring
    as row. A frame without points gives no scan. Coordinates have 32 bits: those of far points are relative to the
    pose of the scan, which is near them."""

    FAR_M: Final = 1024.0
    """Farther points, in the mean of a scan, are far."""

    def __init__(self, path: Path) -> None:
        import pye57

        path.unlink(missing_ok=True)  # its library opens only new files
        self._file = pye57.E57(str(path), mode="w")
        made_anew(path)

    def write(self, frame: Frame, cloud: Cloud) -> None:
        if not len(cloud):
            return
        middle = np.array([cloud[axis].mean(dtype=np.float64) for axis in "xyz"])
        begin = np.where(np.abs(middle) < self.FAR_M, 0.0, np.round(middle, -3))
        data = {f"cartesian{axis.upper()}": cloud[axis] - begin[at] for at, axis in enumerate("xyz")}
        data["intensity"] = cloud["intensity"].astype(np.float32)
        data["rowIndex"] = cloud["ring"].astype(np.int32)
        data["columnIndex"] = np.zeros(len(cloud), np.int32)
        with self._failing():
            self._file.write_scan_raw(data, name=f"frame {frame.index}", translation=begin)

    def close(self) -> None:
        with self._failing():
            self._file.close()

    @contextmanager
    def _failing(self) -> Iterator[None]:
        """Raises OSError where the library says in its own words that it cannot write."""
        import pye57

        try:
            yield
        except pye57.libe57.E57Exception as error:
            self._file.close = _nothing  # it would try once more when it is let go
            raise OSError(str(error).strip().splitlines()[0]) from None


def _nothing() -> None:
    """Closes nothing."""
