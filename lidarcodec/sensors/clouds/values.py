"""What drivers name the values of points: intensities and times, in one form."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.sensors.clouds.message import CloudMessage

LATEST_S: Final = 1e10
"""Absolute times beyond this are in ns: in seconds it is the year 2286."""
AWAY_S: Final = 1000.0
"""Absolute times farther than this from that of the message are of another clock; from one another, of none."""


def intensity_of(message: CloudMessage) -> npt.NDArray[np.uint8] | npt.NDArray[np.uint16]:
    """(N,) the field `intensity`, else `reflectivity` or `i`, as whole numbers: up to 255 in 8 bits, larger ones in 16.

    Fractions of 1 count in 255ths, if there are any; 0 where there is no such field.
    """
    found = next((v for name in ("intensity", "reflectivity", "i") if (v := message.values(name)) is not None), None)
    if found is None or not len(found):
        return np.zeros(message.head.points, np.uint8)
    if found.dtype == np.uint8:
        return found
    with np.errstate(invalid="ignore"):
        values = found.astype(np.float64)
        if found.dtype.kind == "f" and not np.isfinite(values).all():
            values = np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
    most = float(values.max())
    if found.dtype.kind == "f" and 0 < most <= 1.0 and (values != np.rint(values)).any():
        values = values * 255.0
    levels = np.clip(np.rint(values), 0, 65_535)
    return levels.astype(np.uint8) if levels.max() <= 255 else levels.astype(np.uint16)


def times_ns(message: CloudMessage) -> npt.NDArray[np.int64]:
    """(N,) time of each point after that of the message, by the fields of drivers; 0 without one.

    `time` float32 in seconds (velodyne), `t` and `time_stamp` uint32 in ns (ouster-ros, nebula), `timestamp` float64
    since the epoch, in seconds (hesai, robosense) or in ns (livox)
    """
    for name in ("time", "t", "time_stamp", "timestamp"):
        found = message.values(name)
        if found is None:
            continue
        if found.dtype.kind in "ui":
            return found.astype(np.int64)
        with np.errstate(invalid="ignore"):
            seconds = np.nan_to_num(found.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0)
        if name == "timestamp":
            seconds = _after(seconds, message.head.stamp_ns * 1e-9)
        return np.rint(np.clip(seconds, -1e6, 1e6) * 1e9).astype(np.int64)
    return np.zeros(message.head.points, np.int64)


def _after(times: npt.NDArray[np.float64], begin_s: float) -> npt.NDArray[np.float64]:
    """(N,) seconds of absolute times after that of the message. Those of another clock, as of a sensor that nobody set,
    count from the earliest one; 0 where there is no time."""
    known = times != 0.0
    if not known.any():
        return np.zeros(len(times))
    at = (int(np.count_nonzero(known)) - 1) // 2
    middle = float(np.partition(times[known], at)[at])
    if abs(middle) > LATEST_S:
        times, middle = times / 1e9, middle / 1e9
    known &= np.abs(times - middle) <= AWAY_S
    if abs(middle - begin_s) > AWAY_S:
        begin_s = float(times[known].min())
    return np.where(known, times - begin_s, 0.0)
