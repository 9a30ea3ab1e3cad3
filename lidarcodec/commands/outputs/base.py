"""The interface of an output of frames, and what formats of points share."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SettingsError
from lidarcodec.frame import Frame

logger = logging.getLogger(__name__)

Cloud = npt.NDArray[np.void]
"""(N,) structured array of points, as `Frame.cloud()` gives it, perhaps moved and cut."""
NARROW: Final = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "u1"), ("laser", "u1"), ("ring", "u1"), ("frame", "<i4"),
     ("t", "<f8")]
)  # fmt: skip
"""A point with what all formats of points hold; `t` in seconds since the first point of the output."""
NARROW_M: Final = 16_384.0
"""Farther coordinates of 32 bits are more than a millimetre apart."""
RETURN_NUMBER: Final = "return_number"
"""Field of a cloud and of rows where all returns are asked for: 1 or 2."""
WIDE: Final = np.dtype([(name, "<u2" if name == "intensity" else NARROW[name].str) for name in NARROW.names or ()])
"""The same with intensities of 16 bits."""
REAL: Final = np.dtype([(name, "<f4" if name == "intensity" else NARROW[name].str) for name in NARROW.names or ()])
"""The same with intensities of any width as real numbers, for readers that take no others."""


NO_CLOUD: Final = np.empty(0, [("x", "f4")])
"""For formats that do not hold points."""


@dataclass(frozen=True)
class BagNames:
    """Names in a bag of clouds. None: `/points`, and the frame that `frame_id_of` gives"""

    topic: str | None = None
    frame_id: str | None = None


USUAL: Final = BagNames()


class Output(Protocol):
    """A file or folder for frames; `close` completes it."""

    def write(self, frame: Frame, cloud: Cloud) -> None:
        """Append one frame. cloud: its points; formats of packets and images ignore them."""

    def close(self) -> None:
        """Finish the file."""


def is_wide(frame: Frame, cloud: Cloud) -> bool:
    """Whether intensities of a stream have 16 bits. Messages of a point cloud have the type that each of them needs."""
    return frame.sensor.is_cloud or cloud["intensity"].dtype != np.uint8


def check_near(frame: Frame, cloud: Cloud, ending: str) -> None:
    """Raise SettingsError for points that were moved so far that a format with coordinates of 32 bits blurs them."""
    if cloud["x"].dtype.itemsize > 4 and len(cloud):
        far_m = max(float(np.abs(cloud[axis]).max()) for axis in "xyz")
        if not far_m <= NARROW_M:
            others = ".las, .csv or .e57" if ending == ".ply" else ".ply, .las, .csv or .e57"
            raise SettingsError(
                f"points of frame {frame.index} are {far_m:,.0f} m away, and {ending} has coordinates of 32 bits here, "
                f"which are {np.spacing(np.float32(far_m)):.3g} m apart there: write {others}"
            )


class Rows:
    """Turns clouds into rows of one type: that of the first frame, whose sensor says how wide intensities are, and
    whether coordinates have 64 bits.

    dtype: NARROW or WIDE, with the coordinates of the clouds, known after the first frame, or always REAL; with
           RETURN_NUMBER if the clouds have it
    """

    def __init__(self, ending: str, *, real: bool = False) -> None:
        self._ending, self._real = ending, real
        self._start_ns: int | None = None
        self._clipped = False
        self.dtype = NARROW

    def of(self, frame: Frame, cloud: Cloud) -> npt.NDArray[np.void]:
        """(N,) rows of `dtype`.

        Raises SettingsError if the number of the frame is too large, or points are too far away for 32 bits.
        """
        if self._start_ns is None:
            self._start_ns = frame.stamp_ns
            self.dtype = REAL if self._real else WIDE if is_wide(frame, cloud) else NARROW
            if RETURN_NUMBER in (cloud.dtype.names or ()):
                self.dtype = np.dtype([*self.dtype.descr, (RETURN_NUMBER, "u1")])
            if not self._real:
                axes = {axis: cloud[axis].dtype.str for axis in "xyz"}
                names = self.dtype.names or ()
                self.dtype = np.dtype([(name, axes.get(name, self.dtype[name].str)) for name in names])
        if self.dtype["x"].itemsize == 4:
            check_near(frame, cloud, self._ending)
        rows = np.empty(len(cloud), self.dtype)
        for name in ("x", "y", "z", "laser", "ring"):
            rows[name] = cloud[name]
        top = 255 if self.dtype["intensity"] == np.uint8 else 65535
        if not self._clipped and cloud["intensity"].max(initial=0) > top:
            self._clipped = True
            logger.warning(
                "intensities from frame %d on are clipped to %d, because those of the first sensor have 8 bits",
                frame.index,
                top,
            )
        rows["intensity"] = np.minimum(cloud["intensity"].astype(np.uint16), top)
        if frame.index > np.iinfo(np.int32).max:
            raise SettingsError(
                f"the number of frame {frame.index} is too large for {self._ending}: write .npz or .pcap"
            )
        rows["frame"] = frame.index
        if RETURN_NUMBER in (self.dtype.names or ()):
            rows[RETURN_NUMBER] = cloud[RETURN_NUMBER]
        rows["t"] = (cloud["t_ns"] - self._start_ns) * 1e-9
        return rows
