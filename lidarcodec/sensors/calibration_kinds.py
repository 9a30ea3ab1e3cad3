"""Whose calibration a file is, by what stands in it: one of another maker's sensor is named as what it is.

>>> kind_in(b"Laser id,Elevation,Azimuth").maker, kind_in(b"lasers: []").maker, kind_in(b"1, 2") is None
('Hesai', 'Velodyne', True)
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

from lidarcodec.errors import CalibrationError
from lidarcodec.sensor_model import HDL64E
from lidarcodec.sensors.hesai_csv import is_header
from lidarcodec.sensors.models.ouster.metadata import read_metadata
from lidarcodec.sensors.models.table import is_ouster, sensor_named

LOOKED_AT: Final = 1 << 16
TAKEN: Final = {
    "Velodyne": "a db.xml or a ROS .yaml",
    "Hesai": "Hesai's angle correction .csv",
    "Ouster": "its metadata .json",
}
"""Maker -> the files that its sensors take."""
_OUSTER: Final = (b'"beam_altitude_angles"', b'"lidar_data_format"', b'"beam_intrinsics"')
_ROS: Final = re.compile(rb"^lasers\s*:", re.MULTILINE)


class Kind(NamedTuple):
    """Whose file it is, and what it is, for people."""

    maker: str
    what: str


def kind_in(data: bytes) -> Kind | None:
    """What a file is; None if that cannot be seen."""
    text = data.removeprefix(b"\xef\xbb\xbf").lstrip()
    head = text[:LOOKED_AT]
    if head[:1] == b"{" and any(key in text for key in _OUSTER):
        return Kind("Ouster", f"the metadata of an Ouster{_product(data)}")
    if head[:1] == b"<" and b"boost_serialization" in head:
        return Kind("Velodyne", "the db.xml of a Velodyne")
    if is_header(head.partition(b"\n")[0].decode("utf-8", "replace")):
        return Kind("Hesai", "the angle correction file of a Hesai")
    if _ROS.search(head):
        return Kind("Velodyne", "the ROS calibration of a Velodyne")
    return None


def check_maker(data: bytes, model: str, name: str) -> None:
    """Refuse a calibration that is of a sensor of another maker. name: of the file

    Raises CalibrationError that says what the file is, and what the sensor takes.
    """
    found = kind_in(data)
    title = "Ouster" if is_ouster(model) else "Velodyne HDL-64E" if model == HDL64E else sensor_named(model).title
    maker = title.partition(" ")[0]
    if found is not None and found.maker != maker and maker in TAKEN:
        article = "an" if maker == "Ouster" else "a"
        raise CalibrationError(
            f"{name} is {found.what}, but the sensor is {article} {title}, which takes {TAKEN[maker]}"
        )


def _product(data: bytes) -> str:
    try:
        return f" {read_metadata(data).product}"
    except CalibrationError:
        return ""
