"""The file that describes a sensor: its calibration, or an Ouster's metadata. Packets alone give no points.

It lies beside a capture, or its text is in a recording of packets, which may be all that a vehicle brings home.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from lidarcodec.errors import CalibrationError
from lidarcodec.sensor_model import HDL64E, POINTCLOUD2, SensorModel
from lidarcodec.sensors import db_xml, hesai_csv
from lidarcodec.sensors.models.ouster.sensor import model_from, sensor_from
from lidarcodec.sensors.models.table import PACKETS, is_ouster, sensor_named
from lidarcodec.sensors.recognise import HDL64
from lidarcodec.sources.unit_calibration import is_generic

DB_XML: Final = "_db.xml"
TEXT: Final = "calibration_text"
ENDING: Final = "calibration_file"
"""Names of two texts of a recording of packets: the contents of the file, and how its name ends beside a capture."""


def description_of(sensor: SensorModel) -> tuple[str, bytes] | None:
    """How the file's name ends, and its bytes; None where none is needed.

    A generic calibration is none: it would no longer be known as such.
    """
    if sensor.model in (PACKETS, POINTCLOUD2):  # whose packets say all
        return None
    if sensor.description:
        return ".json", sensor.description
    if is_generic(sensor):
        return None
    if not sensor.is_hdl64e and sensor_named(sensor.model).title.startswith("Hesai"):
        return ".csv", hesai_csv.text(sensor.calibration).encode()
    return DB_XML, db_xml.text(sensor.calibration).encode()


def noted(sensor: SensorModel) -> dict[str, str]:
    """The two texts of a recording of this sensor's packets; empty where none is needed, or packets have them."""
    found = None if sensor.origin == "stream" and not sensor.description else description_of(sensor)
    return {} if found is None else {ENDING: found[0], TEXT: found[1].decode("utf-8", "replace")}


def sensor_noted(texts: Mapping[str, str], model: str, payloads: Sequence[bytes]) -> SensorModel | None:
    """The sensor that these texts of a recording describe; None without them.

    Raises CalibrationError if they do not describe a sensor of that model that sends such packets.
    """
    if TEXT not in texts:
        return None
    data = texts[TEXT].encode()
    if is_ouster(model):
        size = sensor_from(data).layout.packet_bytes
        if payloads and all(len(payload) != size for payload in payloads):
            raise CalibrationError(f"it is of an Ouster that sends packets of {size} bytes, not {len(payloads[0])}")
        return model_from(data, "given")
    if model == HDL64E:
        return SensorModel(HDL64, db_xml.parse(data), "given")
    return sensor_named(model).calibrated(data, "given", TEXT)


def without_text(texts: Mapping[str, str]) -> dict[str, str]:
    """Texts of a recording to be shown: of the contents of the file only how many bytes they have."""
    return {name: f"{len(text.encode()):,} bytes" if name == TEXT else text for name, text in texts.items()}
