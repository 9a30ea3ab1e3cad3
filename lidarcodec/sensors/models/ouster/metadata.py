"""What an Ouster says of itself: the metadata JSON of every firmware as one record.

Up to firmware 2.x, and in files of its tools, the JSON is flat: `beam_altitude_angles`, `data_format`, `prod_line` side
by side. What `/api/v1/sensor/metadata` gives is nested: `beam_intrinsics`, `lidar_intrinsics`, `lidar_data_format`,
`config_params`, `sensor_info`. A key is looked for in its section, then at the top.

What old files lack is what those sensors had, as ouster-sdk 1.0.1 fills it in:

    data_format                       LEGACY, columns of lidar_mode, 16 columns a packet, the whole turn; pixel shifts
                                      18, 12, 6, 0 and again (of 1024 columns)
    lidar_origin_to_beam_origin_mm    27.67 (OS-0), 15.806 (OS-1), 13.762 (OS-2), 12.163 without prod_line
    beam_to_lidar_transform           that distance along x
    lidar_to_sensor_transform         half a turn about z, 36.18 mm up
    prod_line                         OS-1, the only Ouster whose files had none
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import CalibrationError
from lidarcodec.sensors.models.ouster.fields import FUSA, LEGACY, PIXELS
from lidarcodec.sensors.models.ouster.layouts import (
    COLUMNS_PER_PACKET,
    MAX_COLUMNS_PER_PACKET,
    MAX_PACKET_BYTES,
    ROWS,
    OusterLayout,
)
from lidarcodec.untrusted.json import JsonRefusedError, read_object

Floats = npt.NDArray[np.float64]

COLUMNS_PER_FRAME: Final = (512, 1024, 2048, 4096)
MAX_LENGTH_MM: Final = 10_000.0
MAX_ROTATION_ERROR: Final = 1e-3
BEAM_ORIGIN_MM: Final = {"0": 27.67, "1": 15.806, "2": 13.762}
FIRST_BEAM_ORIGIN_MM: Final = 12.163
FIRST_PIXEL_SHIFTS: Final = (18, 12, 6, 0)
FIRST_LIDAR_TO_SENSOR: Final = (-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1)
MAX_SERIAL: Final = 1 << 40
"""Packets have 40 bits for it."""
_PRODUCT: Final = re.compile(r"OS-?(0|1|2|DOME)(?![0-9A-Z])", re.IGNORECASE)
_MODE: Final = re.compile(r"([0-9]{3,4})x([0-9]{1,2})")
_SERIAL: Final = re.compile(r"[0-9]{1,13}")


@dataclass(frozen=True, eq=False)
class OusterMetadata:
    """The metadata of one Ouster; H rows from the top beam down.

    model: `os1-128`; product: `OS-1-128`; serial: 0 if not known; layout: of its packets
    lidar_mode: `1024x10`, columns and turns a second; column_window: first and last measurement id that is sent
    beam_altitude_deg, beam_azimuth_deg: (H,); pixel_shift_by_row: (H,) columns
    beam_to_lidar, lidar_to_sensor: (4, 4), lengths in mm; lidar_origin_to_beam_origin_mm: from the axis to the beams
    """

    model: str
    product: str
    serial: int
    layout: OusterLayout
    lidar_mode: str
    column_window: tuple[int, int]
    beam_altitude_deg: Floats
    beam_azimuth_deg: Floats
    pixel_shift_by_row: npt.NDArray[np.int64]
    lidar_origin_to_beam_origin_mm: float
    beam_to_lidar: Floats
    lidar_to_sensor: Floats

    @property
    def columns_per_frame(self) -> int:
        """Columns of a whole turn."""
        return self.layout.turn_columns

    @property
    def turns_per_second(self) -> int:
        """How fast it turns."""
        return int(self.lidar_mode.partition("x")[2])


def read_metadata(metadata: bytes) -> OusterMetadata:
    """The metadata of an Ouster, from its JSON.

    Raises CalibrationError if it is not that of a sensor whose packets have a layout here.
    """
    try:
        tree = read_object(metadata)
    except JsonRefusedError as error:
        raise CalibrationError(f"this is not the metadata of an Ouster: {error}") from None
    altitudes = _beams(tree, "beam_altitude_angles", 90)
    azimuths = _beams(tree, "beam_azimuth_angles", 360)
    rows = len(altitudes)
    data = _section(tree, "lidar_data_format") or _section(tree, "data_format")
    mode, columns = _mode(tree, data)
    layout = _layout(tree, data, rows, columns)
    if len(azimuths) != rows:
        raise CalibrationError(f"beam_azimuth_angles has {len(azimuths)} angles, but beam_altitude_angles has {rows}")
    product = _text(tree, "sensor_info", "prod_line") or ""
    line = _PRODUCT.match(product)
    if product and line is None:
        raise CalibrationError(f"prod_line is {product!r:.40}, which is not an OS0, OS1, OS2 or OSDome")
    family = line[1].lower() if line else "1"
    origin = _number(tree, "lidar_origin_to_beam_origin_mm", "beam_intrinsics")
    if origin is None:
        origin = BEAM_ORIGIN_MM.get(family, 0.0) if line else FIRST_BEAM_ORIGIN_MM
    along_x = (1, 0, 0, origin, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1)
    return OusterMetadata(
        model=f"os{family}-{rows}",
        product=product or f"OS-1-{rows}",
        serial=_serial(tree),
        layout=layout,
        lidar_mode=mode,
        column_window=_window(data, columns),
        beam_altitude_deg=altitudes,
        beam_azimuth_deg=azimuths,
        pixel_shift_by_row=_shifts(data, rows, columns),
        lidar_origin_to_beam_origin_mm=origin,
        beam_to_lidar=_transform(tree, "beam_intrinsics", "beam_to_lidar_transform", along_x),
        lidar_to_sensor=_transform(tree, "lidar_intrinsics", "lidar_to_sensor_transform", FIRST_LIDAR_TO_SENSOR),
    )


def _section(tree: dict[str, Any], name: str) -> dict[str, Any]:
    """A section; empty if there is none."""
    section = tree.get(name, {})
    if not isinstance(section, dict):
        raise CalibrationError(f"{name} must be an object, not {section!r:.40}")
    return section


def _find(tree: dict[str, Any], section: str, key: str) -> Any:
    """The value of a key in its section or at the top; None if it is in neither."""
    return _section(tree, section).get(key, tree.get(key))


def _text(tree: dict[str, Any], section: str, key: str) -> str | None:
    found = _find(tree, section, key)
    if found is not None and not isinstance(found, str):
        raise CalibrationError(f"{key} must be a text, not {found!r:.40}")
    return found


def _is_number(value: Any, most: float) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= most


def _is_whole(value: Any, least: int, most: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and least <= value <= most


def _number(tree: dict[str, Any], key: str, section: str) -> float | None:
    found = _find(tree, section, key)
    if found is None:
        return None
    if not _is_number(found, MAX_LENGTH_MM):
        raise CalibrationError(f"{key} must be a length of at most {MAX_LENGTH_MM:,.0f} mm, not {found!r:.40}")
    return float(found)


def _list(found: Any, key: str) -> Sequence[Any]:
    if not isinstance(found, list):
        raise CalibrationError(f"it lacks the list {key}, which the metadata of every Ouster has")
    return found


def _beams(tree: dict[str, Any], key: str, most_deg: float) -> Floats:
    found = _list(_find(tree, "beam_intrinsics", key), key)
    if len(found) not in ROWS:
        raise CalibrationError(f"{key} has {len(found)} values: an Ouster has {', '.join(map(str, ROWS))} beams")
    if not all(_is_number(value, most_deg) for value in found):
        raise CalibrationError(f"{key} must hold angles of at most {most_deg} degrees")
    angles = np.array(found, np.float64)
    angles.flags.writeable = False
    return angles


def _mode(tree: dict[str, Any], data: dict[str, Any]) -> tuple[str, int]:
    """Mode, and columns of a whole turn."""
    mode, columns = _text(tree, "config_params", "lidar_mode"), data.get("columns_per_frame")
    if mode is None:
        raise CalibrationError("it lacks lidar_mode, which the metadata of every Ouster has")
    match = _MODE.fullmatch(mode)
    if match is None or int(match[1]) not in COLUMNS_PER_FRAME or int(match[2]) == 0:
        raise CalibrationError(f"lidar_mode is {mode!r:.40}: it must be a mode of an Ouster, such as 1024x10")
    if columns is not None and columns != int(match[1]):
        raise CalibrationError(f"columns_per_frame is {columns!r:.40}, but lidar_mode is {mode}")
    return mode, int(match[1])


def _layout(tree: dict[str, Any], data: dict[str, Any], rows: int, columns: int) -> OusterLayout:
    pixels, each = data.get("pixels_per_column", rows), data.get("columns_per_packet", COLUMNS_PER_PACKET)
    if pixels != rows:
        raise CalibrationError(f"pixels_per_column is {pixels!r:.40}, but beam_altitude_angles has {rows} angles")
    if not _is_whole(each, 1, MAX_COLUMNS_PER_PACKET):
        raise CalibrationError(f"columns_per_packet must be 1 to {MAX_COLUMNS_PER_PACKET}, not {each!r:.40}")
    profile = data.get("udp_profile_lidar", _find(tree, "config_params", "udp_profile_lidar"))
    profile = LEGACY if profile is None else profile
    if not isinstance(profile, str) or profile not in PIXELS:
        raise CalibrationError(f"the profile {profile!r:.60} is unknown: choose one of {', '.join(PIXELS)}")
    head = data.get("header_type", "FUSA" if profile == FUSA else "STANDARD")
    if head not in ("STANDARD", "FUSA"):
        raise CalibrationError(f"header_type must be STANDARD or FUSA, not {head!r:.40}")
    layout = OusterLayout(profile, rows, each, profile != LEGACY and head == "FUSA", columns)
    if layout.packet_bytes > MAX_PACKET_BYTES:
        raise CalibrationError(
            f"{each} columns of {rows} pixels are {layout.packet_bytes:,} bytes: no packet is so large"
        )
    return layout


def _window(data: dict[str, Any], columns: int) -> tuple[int, int]:
    window = data.get("column_window", [0, columns - 1])
    if not isinstance(window, list) or len(window) != 2 or not all(_is_whole(at, 0, columns - 1) for at in window):
        raise CalibrationError(f"column_window must be two of 0 to {columns - 1}, not {window!r:.40}")
    return window[0], window[1]


def _shifts(data: dict[str, Any], rows: int, columns: int) -> npt.NDArray[np.int64]:
    found = data.get("pixel_shift_by_row")
    if found is None:
        found = [shift * columns // 1024 for shift in FIRST_PIXEL_SHIFTS] * (rows // len(FIRST_PIXEL_SHIFTS))
    if len(_list(found, "pixel_shift_by_row")) != rows:
        raise CalibrationError(f"pixel_shift_by_row has {len(found)} values, but beam_altitude_angles has {rows}")
    if not all(_is_whole(shift, -columns, columns) for shift in found):
        raise CalibrationError(f"pixel_shift_by_row must hold whole numbers of at most {columns} columns")
    shifts = np.array(found, np.int64)
    shifts.flags.writeable = False
    return shifts


def _transform(tree: dict[str, Any], section: str, key: str, default: Sequence[float]) -> Floats:
    found = _find(tree, section, key)
    if isinstance(found, list) and len(found) == 4 and all(isinstance(row, list) for row in found):
        found = [value for row in found for value in row]
    values = default if found is None else _list(found, key)
    if len(values) != 16 or not all(_is_number(value, MAX_LENGTH_MM) for value in values):
        raise CalibrationError(f"{key} must hold 16 numbers, lengths of at most {MAX_LENGTH_MM:,.0f} mm")
    matrix = np.array(values, np.float64).reshape(4, 4)
    rotation = matrix[:3, :3]
    off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if off > MAX_ROTATION_ERROR or np.linalg.det(rotation) < 0 or matrix[3].tolist() != [0, 0, 0, 1]:
        raise CalibrationError(f"{key} must be a rotation and a shift, with 0 0 0 1 in its last row")
    matrix.flags.writeable = False
    return matrix


def _serial(tree: dict[str, Any]) -> int:
    serial = _text(tree, "sensor_info", "prod_sn") or "0"
    return int(serial) if _SERIAL.fullmatch(serial) and int(serial) < MAX_SERIAL else 0
