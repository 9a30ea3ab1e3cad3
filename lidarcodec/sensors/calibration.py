"""Calibration files: Velodyne `db.xml` (degrees, centimetres) and ROS `.yaml` (radians, metres) -> SensorModel.

Both forms hold the same values per laser: `db_xml` and `ros_yaml` read and write them, and `corrections` checks
that a table is that of an HDL-64E.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from lidarcodec.budgets import FileTooLargeError, read_file
from lidarcodec.errors import CalibrationError, LidarCodecError
from lidarcodec.files.whole import written_whole
from lidarcodec.sensor_model import Calibration, Origin, SensorModel
from lidarcodec.sensors.recognise import HDL64


def read_calibration(path: Path, origin: Origin = "given") -> SensorModel:
    """The HDL-64E that a `db.xml` or ROS `.yaml` file describes; the format is recognised by the content.

    Raises CalibrationError if the file cannot be read, or is not the calibration of an HDL-64E.
    """
    from lidarcodec.sensors import db_xml, ros_yaml

    try:
        data = read_file(Path(path), "calibration")
    except OSError as error:
        raise CalibrationError(f"cannot read calibration {path}: {error.strerror or error}") from error
    except FileTooLargeError as error:
        raise CalibrationError(f"calibration {path}: {error}: this is not a calibration file") from None
    reader: Callable[[bytes], Calibration]
    reader = db_xml.parse if data.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] == b"<" else ros_yaml.parse
    try:
        return SensorModel(HDL64, reader(data), origin)
    except CalibrationError as error:
        raise CalibrationError(f"calibration {path}: {error}") from error


def write_calibration(sensor: SensorModel, path: Path) -> None:
    """Write `.yaml` or `.yml` in the ROS form, anything else as `db.xml`.

    Raises CalibrationError if the file cannot be written.
    """
    (write_yaml if Path(path).suffix.lower() in (".yaml", ".yml") else write_db_xml)(sensor, path)


def write_db_xml(sensor: SensorModel, path: Path) -> None:
    """Write Velodyne's `db.xml` form; reading it gives the same table.

    Raises CalibrationError if the file cannot be written.
    """
    from lidarcodec.sensors import db_xml

    _write(path, db_xml.text(sensor.calibration))


def write_yaml(sensor: SensorModel, path: Path) -> None:
    """Write the ROS `.yaml` form; reading it gives the same table.

    Raises CalibrationError if the file cannot be written.
    """
    from lidarcodec.sensors import ros_yaml

    _write(path, ros_yaml.text(sensor.calibration))


def _write(path: Path, text: str) -> None:
    try:
        with written_whole(Path(path)) as beside:
            beside.write_text(text, encoding="utf-8")
    except LidarCodecError as error:
        raise CalibrationError(f"cannot write calibration {path}: {error}") from None
