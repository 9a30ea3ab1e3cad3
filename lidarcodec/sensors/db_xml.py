"""Calibration in Velodyne's form: `db.xml`, a boost archive in degrees and centimetres.

A list of 64 `px` elements in `points_` holds the corrections, lists beside it the intensity limits and which lasers are
enabled: a VLP-16's file has 64 places too, with 16 enabled.
"""

from __future__ import annotations

import math
from typing import Any
from xml.etree import ElementTree

from lidarcodec.errors import CalibrationError
from lidarcodec.sensor_model import CALIBRATION_FIELDS, Calibration
from lidarcodec.sensors.corrections import OTHER_SENSORS, OWN, SENSORS, table_of
from lidarcodec.units import LASERS, RANGE_STEP_M
from lidarcodec.untrusted.xml import XmlRefusedError, read_xml

CM = 0.01
TAGS: dict[str, str] = {
    "rot_correction_rad": "rotCorrection_",
    "vert_correction_rad": "vertCorrection_",
    "dist_correction_m": "distCorrection_",
    "dist_correction_x_m": "distCorrectionX_",
    "dist_correction_y_m": "distCorrectionY_",
    "vert_offset_m": "vertOffsetCorrection_",
    "horiz_offset_m": "horizOffsetCorrection_",
    "focal_distance_m": "focalDistance_",
    "focal_slope": "focalSlope_",
}
"""Element of `px` for each calibration field."""
MAX_ELEMENTS = 20_000
"""Most elements; real files have about 1,500."""


def parse(data: bytes, number: int = LASERS) -> Calibration:
    """Calibration of a `db.xml` file of a sensor with so many lasers.

    Raises CalibrationError if it is not one, or of another sensor.
    """
    root = _tree(data)
    database = root.find("DB")
    points = None if database is None else database.find("points_")
    if database is None or points is None:
        raise CalibrationError("it lacks DB/points_, which every Velodyne db.xml has")
    lasers = [_laser(px) for px in points.iterfind("item/px")]
    lasers = _enabled(lasers, _numbers(database, "enabled_"), number)
    for name, tag in (("min_intensity", "minIntensity_"), ("max_intensity", "maxIntensity_")):
        limits = _numbers(database, tag)
        for laser in lasers:
            place = laser["laser_id"]
            if isinstance(place, int) and 0 <= place < len(limits):
                laser[name] = limits[place]
    step_cm = database.findtext("distLSB_")
    step_m = RANGE_STEP_M if step_cm is None else _number(step_cm, "distLSB_") * CM
    return table_of(lasers, step_m, number)


def text(calibration: Calibration, range_step_m: float = RANGE_STEP_M) -> str:
    """The `db.xml` form of a calibration, with as many digits as the table keeps."""
    number = calibration.table.shape[1]
    degrees, cm = math.degrees(1.0), 1 / CM
    columns: dict[str, tuple[Any, int]] = {}
    for name, tag in TAGS.items():
        if name.endswith("_rad"):
            columns[tag] = (calibration[name] * degrees, 9)
        elif name.endswith("_m"):
            columns[tag] = (calibration[name] * cm, 5)
        else:
            columns[tag] = (calibration[name], 6)
    points = []
    for laser in range(number):
        head = '<px class_id="9" tracking_level="1" version="1"' if laser == 0 else '<px class_id_reference="9"'
        fields = [f"<id_>{laser}</id_>"]
        texts = {tag: _shortest(values[laser], decimals) for tag, (values, decimals) in columns.items()}
        fields += [f"<{tag}>{value}</{tag}>" for tag, value in texts.items()]
        body = "".join(f"\n\t\t\t\t{field}" for field in fields)
        points.append(f'{head} object_id="_{laser + 1}">{body}\n\t\t\t</px>')
    items = [f"<item>\n\t\t\t{point}\n\t\t</item>" for point in points]
    items[0] = items[0].replace("<item>", '<item class_id="8" tracking_level="0" version="1">', 1)
    limits = {
        "minIntensity_": [f"{value:.0f}" for value in calibration["min_intensity"]],
        "maxIntensity_": [f"{value:.0f}" for value in calibration["max_intensity"]],
    }
    return "\n".join(
        [
            '<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>',
            "<!DOCTYPE boost_serialization>",
            '<boost_serialization signature="serialization::archive" version="4">',
            '<DB class_id="0" tracking_level="1" version="0" object_id="_0">',
            f"\t<distLSB_>{range_step_m / CM:g}</distLSB_>",
            *(
                _vector(tag, inner, class_id)
                for tag, inner, class_id in (("position_", "xyz", 1), ("orientation_", "rpy", 2))
            ),
            _list('colors_ class_id="3" tracking_level="0" version="0"', _colours(number), version=0),
            _list("enabled_", _items(["1"] * number)),
            _list("intensity_", _items(["0"] * number)),
            *(_list(tag, _items(values), version=0) for tag, values in limits.items()),
            _list('points_ class_id="7" tracking_level="0" version="0"', items, version=1),
            "</DB>",
            "</boost_serialization>",
            "",
        ]
    )


def _tree(data: bytes) -> ElementTree.Element:
    try:
        return read_xml(data, most_elements=MAX_ELEMENTS)
    except XmlRefusedError as error:
        raise CalibrationError(f"{error}: this is not a db.xml") from error


def _laser(px: ElementTree.Element) -> dict[str, Any]:
    laser: dict[str, Any] = {}
    number = _number(px.findtext("id_") or "", "id_")
    laser["laser_id"] = int(number) if number.is_integer() else number
    for name, tag in TAGS.items():
        found = px.findtext(tag)
        if found is None:
            continue
        value = _number(found, tag)
        laser[name] = math.radians(value) if name.endswith("_rad") else value * CM if name.endswith("_m") else value
    return laser


def _number(found: str, tag: str) -> float:
    try:
        value = float(found)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise CalibrationError(f"{tag} must be a number, not {found.strip()!r:.40}")
    return value


def _numbers(database: ElementTree.Element, tag: str) -> list[float]:
    return [_number(item.text or "", tag) for item in database.iterfind(f"{tag}/item")]


def _enabled(lasers: list[dict[str, Any]], enabled: list[float], number: int) -> list[dict[str, Any]]:
    """The lasers that the sensor has: of the 64 places in a file of another sensor, those that are enabled."""
    used = sum(value != 0 for value in enabled)
    if len(lasers) != LASERS or used == LASERS or used not in {number, *OTHER_SENSORS}:
        return lasers
    if used != number:
        whose = SENSORS.get(number, OWN)
        raise CalibrationError(f"{used} lasers are enabled, as in {OTHER_SENSORS[used]}, but {whose} has {number}")
    on = {place for place, value in enumerate(enabled) if value != 0}
    return [laser for laser in lasers if laser["laser_id"] in on]


def _shortest(value: float, decimals: int) -> str:
    number = f"{value:.{decimals}f}".rstrip("0").rstrip(".")
    return "0" if number in ("-0", "") else number


def _items(values: list[str]) -> list[str]:
    return [f"<item>{value}</item>" for value in values]


def _list(head: str, items: list[str], version: int | None = None) -> str:
    versions = [] if version is None else [f"<item_version>{version}</item_version>"]
    body = "".join(f"\n\t\t{line}" for line in [f"<count>{len(items)}</count>", *versions, *items])
    return f"\t<{head}>{body}\n\t</{head.partition(' ')[0]}>"


def _vector(tag: str, inner: str, class_id: int) -> str:
    zeros = "".join("\n\t\t\t<item>0</item>" for _ in range(3))
    head = f'\t<{tag} class_id="{class_id}" tracking_level="0" version="0">'
    return f"{head}\n\t\t<{inner}>\n\t\t\t<count>3</count>{zeros}\n\t\t</{inner}>\n\t</{tag}>"


def _colours(lasers: int) -> list[str]:
    """A colour for each laser, as viewers want one: blue to red."""
    colours = []
    for laser in range(lasers):
        share = laser / (lasers - 1)
        values = "".join(f"\n\t\t\t\t<item>{value:.3f}</item>" for value in (share, 0.5, 1 - share))
        head = '<item class_id="4" tracking_level="0" version="0">' if laser == 0 else "<item>"
        colours.append(f"{head}\n\t\t\t<rgb>\n\t\t\t\t<count>3</count>{values}\n\t\t\t</rgb>\n\t\t</item>")
    return colours


assert set(TAGS) <= set(CALIBRATION_FIELDS)
