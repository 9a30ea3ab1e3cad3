"""Points as LAS 1.4, also compressed (LAZ)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.commands.outputs.base import NO_CLOUD, RETURN_NUMBER, Cloud, is_wide
from lidarcodec.errors import SettingsError
from lidarcodec.frame import Frame

if TYPE_CHECKING:
    import laspy

GPS_EPOCH_S: Final = 315_964_800
"""Start of GPS time, 6 January 1980, in seconds of Unix time."""
ADJUSTED_S: Final = 1_000_000_000
"""LAS subtracts this from GPS seconds ("adjusted standard GPS time", LAS 1.4 R15, table 4, bit 0)."""
LEAP_SECONDS: Final = (
    362793600, 394329600, 425865600, 489024000, 567993600, 631152000, 662688000, 709948800, 741484800, 773020800,
    820454400, 867715200, 915148800, 1136073600, 1230768000, 1341100800, 1435708800, 1483228800,
)  # fmt: skip
"""Unix times from which GPS is a second further ahead of UTC, July 1981 to January 2017 (IERS Bulletin C)."""


def gps_seconds(stamp_ns: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """(N,) float64, adjusted standard GPS time of Unix times in ns.

    >>> gps_seconds(np.array([1_483_228_800 * 10**9]))  # 2017-01-01: GPS is 18 s ahead
    array([1.67264018e+08])
    """
    ahead = np.searchsorted(np.array(LEAP_SECONDS) * 10**9, stamp_ns, side="right")
    whole = stamp_ns // 10**9 - GPS_EPOCH_S - ADJUSTED_S + ahead
    return whole + (stamp_ns % 10**9) * 1e-9


def returns_of_beams(cloud: Cloud, number: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """(N,) uint8, number of returns of each point's beam. A beam is one firing of one laser.

    number: (N,) number of each point among the returns of its beam
    """
    beams = (cloud["t_ns"] - cloud["t_ns"].min(initial=np.iinfo(np.int64).max)) * 256 + cloud["laser"]
    twice: npt.NDArray[np.bool_] = np.isin(beams, beams[number == 2])
    return np.where(twice, 2, 1).astype(np.uint8)


@contextmanager
def _failing() -> Iterator[None]:
    """Raises OSError instead of the error of the LAZ library when a file cannot be written."""
    try:
        yield
    except Exception as error:
        if type(error).__name__ != "LazrsError":  # the library may not be installed
            raise
        raise OSError(str(error)) from None


class LasOutput:
    """LAS 1.4 in millimetres: intensity scaled to 16 bits (of point clouds as it is), user_data = ring, point_source_id
    = laser, gps_time = adjusted standard GPS time, as the flags of the file say."""

    STEP_M: Final = 0.001
    FAR_M: Final = 1e5
    """If the first points are farther away, the file has an offset near them: from it coordinates reach 2,147 km."""
    COMPRESSED = False

    def __init__(self, path: Path) -> None:
        import laspy

        header = laspy.LasHeader(point_format=6, version="1.4")
        header.scales = np.full(3, self.STEP_M)
        header.offsets = np.zeros(3)
        header.generating_software = "lidarcodec"
        header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
        header.global_encoding.wkt = True  # LAS 1.4 asks for it with this point format, even without a map projection
        self._header, self._path = header, path
        self._opened: laspy.LasWriter | None = None

    def _writer(self, cloud: Cloud) -> laspy.LasWriter:
        """The file, which begins where the first points are. cloud: the first one"""
        import laspy

        if self._opened is None:
            middle = np.array([cloud[axis].mean(dtype=np.float64) if len(cloud) else 0.0 for axis in "xyz"])
            self._header.offsets = np.where(np.abs(middle) < self.FAR_M, 0.0, np.round(middle, -3))
            self._opened = laspy.open(self._path, mode="w", header=self._header, do_compress=self.COMPRESSED)
        return self._opened

    def write(self, frame: Frame, cloud: Cloud) -> None:
        import laspy

        writer = self._writer(cloud)
        points = laspy.ScaleAwarePointRecord.zeros(len(cloud), header=self._header)
        try:
            points.x, points.y, points.z = (cloud[axis].astype(np.float64) for axis in "xyz")
        except OverflowError:
            raise SettingsError(f"points of frame {frame.index} are too far away for .las: write .ply") from None
        wide = cloud["intensity"].astype(np.uint16)
        points.intensity = wide if is_wide(frame, cloud) else wide * 257
        points.user_data = cloud["ring"]
        points.point_source_id = cloud["laser"].astype(np.uint16)
        points.gps_time = gps_seconds(cloud["t_ns"])
        number = cloud[RETURN_NUMBER] if RETURN_NUMBER in (cloud.dtype.names or ()) else np.ones(len(cloud), np.uint8)
        points.return_number, points.number_of_returns = number, returns_of_beams(cloud, number)
        with _failing():
            writer.write_points(points)

    def close(self) -> None:
        with _failing():
            self._writer(NO_CLOUD).close()


class LazOutput(LasOutput):
    """The same, compressed."""

    COMPRESSED = True
