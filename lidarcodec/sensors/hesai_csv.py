"""Calibration in Hesai's form: angle correction `.csv`, in degrees.

    Laser id,Elevation,Azimuth      (a header line; older files: Channel,Elevation,Azimuth)
    1,14.9,-1.042                   (channels are counted from 1, each once)

Hesai adds the azimuth to that of the block. A Calibration subtracts its rotation correction, so the sign changes.
"""

from __future__ import annotations

import math

import numpy as np

from lidarcodec.errors import CalibrationError
from lidarcodec.sensor_model import Calibration

COLUMNS = ("elevation", "azimuth")
LIMITS_DEG = {"elevation": 90.0, "azimuth": 360.0}
"""Largest magnitude of angles, to detect files of another kind."""
MAX_BYTES = 65_536
"""Largest file; real ones have 4 kB."""


def parse(data: bytes, channels: int) -> Calibration:
    """Calibration of an angle correction `.csv` of a sensor with so many channels.

    Raises CalibrationError saying which line is not one, or how many channels the file has.
    """
    if len(data) > MAX_BYTES:
        raise CalibrationError(
            f"it has {len(data):,} bytes, but a Hesai angle correction file has fewer than {MAX_BYTES:,}"
        )
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise CalibrationError("it is not text: a Hesai angle correction file is a .csv") from None
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip(" ,\t\0")]
    if not lines or not is_header(lines[0][1]):
        raise CalibrationError("its first line is not 'Laser id,Elevation,Azimuth', as in Hesai's .csv files")
    found: dict[int, tuple[float, float]] = {}
    for number, line in lines[1:]:
        channel, angles = _row(number, line)
        if channel in found:
            raise CalibrationError(f"line {number}: channel {channel} occurs twice")
        if not 1 <= channel <= channels:
            raise CalibrationError(f"line {number}: channel {channel} does not exist, this sensor has 1 to {channels}")
        found[channel] = angles
    if len(found) != channels:
        raise CalibrationError(
            f"it has {len(found)} channels, but this sensor has {channels}: it belongs to another model"
        )
    table = np.radians([found[channel] for channel in range(1, channels + 1)])
    return Calibration.from_values({"vert_correction_rad": table[:, 0], "rot_correction_rad": -table[:, 1]})


def text(calibration: Calibration) -> str:
    """The `.csv` form of a calibration, with as many digits as the table keeps."""
    elevations = np.degrees(calibration["vert_correction_rad"])
    azimuths = -np.degrees(calibration["rot_correction_rad"])
    rows = zip(elevations, azimuths, strict=True)
    lines = [f"{channel},{elevation:.7f},{azimuth:.7f}" for channel, (elevation, azimuth) in enumerate(rows, 1)]
    return "\n".join(["Laser id,Elevation,Azimuth", *lines, ""])


def is_header(line: str) -> bool:
    """Whether this is the first line of such a file."""
    names = [cell.strip().lower() for cell in line.split(",")]
    return len(names) >= 3 and names[0] in ("laser id", "channel") and names[1:3] == list(COLUMNS)


def _row(number: int, line: str) -> tuple[int, tuple[float, float]]:
    cells = [cell.strip() for cell in line.split(",")]
    if len(cells) < 3:
        raise CalibrationError(f"line {number} has {len(cells)} values instead of channel, elevation and azimuth")
    if not (cells[0].isascii() and cells[0].isdigit() and len(cells[0]) <= 4):
        raise CalibrationError(f"line {number}: the channel must be a whole number, not {cells[0]!r:.40}")
    elevation, azimuth = (_angle(number, name, cell) for name, cell in zip(COLUMNS, cells[1:3], strict=True))
    return int(cells[0]), (elevation, azimuth)


def _angle(number: int, name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not abs(value) <= LIMITS_DEG[name]:
        raise CalibrationError(
            f"line {number}: the {name} must be degrees within {LIMITS_DEG[name]:g}, not {cell!r:.40}"
        )
    return value
