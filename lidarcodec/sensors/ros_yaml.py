"""Calibration in the ROS form: YAML with a list `lasers`, radians and metres, as in `velodyne_pointcloud/params`."""

from __future__ import annotations

from lidarcodec.errors import CalibrationError
from lidarcodec.sensor_model import ANGLE_UNIT_RAD, CALIBRATION_FIELDS, LENGTH_UNIT_M, Calibration
from lidarcodec.sensors.corrections import table_of
from lidarcodec.units import LASERS, RANGE_STEP_M
from lidarcodec.untrusted.yaml import YamlRefusedError, read_yaml

KEYS: dict[str, str] = {
    "rot_correction_rad": "rot_correction",
    "vert_correction_rad": "vert_correction",
    "dist_correction_m": "dist_correction",
    "dist_correction_x_m": "dist_correction_x",
    "dist_correction_y_m": "dist_correction_y",
    "vert_offset_m": "vert_offset_correction",
    "horiz_offset_m": "horiz_offset_correction",
    "focal_distance_m": "focal_distance",
    "focal_slope": "focal_slope",
    "min_intensity": "min_intensity",
    "max_intensity": "max_intensity",
}
"""Key in the file of each calibration field."""
DECIMALS = {ANGLE_UNIT_RAD: 8, LENGTH_UNIT_M: 7}
TWO_POINT = "two_pt_correction_available"


def parse(data: bytes, lasers: int = LASERS) -> Calibration:
    """Calibration of a ROS `.yaml` file of a sensor with so many lasers.

    Raises CalibrationError if it is not one, or of another sensor.
    """
    try:
        tree = read_yaml(data)
    except YamlRefusedError as error:
        raise CalibrationError(str(error)) from None
    listed = tree.get("lasers") if isinstance(tree, dict) else None
    if not isinstance(listed, list) or not all(isinstance(laser, dict) for laser in listed):
        raise CalibrationError("it lacks the list 'lasers', which every ROS calibration has")
    step = tree.get("distance_resolution", RANGE_STEP_M)
    if isinstance(step, bool) or not isinstance(step, (int, float)) or not abs(step) < 1e9:
        raise CalibrationError(f"distance_resolution must be a number, not {step!r:.40}")
    rows = []
    for laser in listed:
        row = {name: laser.get(key) for name, key in KEYS.items()}
        rows.append(row | {"laser_id": laser.get("laser_id"), "two_point": laser.get(TWO_POINT, True)})
    return table_of(rows, float(step), lasers)


def text(calibration: Calibration, range_step_m: float = RANGE_STEP_M) -> str:
    """The ROS form of a calibration, with as many digits as the table keeps."""
    lines = ["lasers:"]
    near = (calibration["dist_correction_x_m"], calibration["dist_correction_y_m"])
    two_point = (near[0] != calibration["dist_correction_m"]) | (near[1] != calibration["dist_correction_m"])
    columns = {KEYS[name]: (calibration[name], _decimals(step)) for name, step in CALIBRATION_FIELDS.items()}
    number = calibration.table.shape[1]
    for laser in range(number):
        fields = {key: f"{values[laser]:.{decimals}f}" for key, (values, decimals) in columns.items()}
        fields |= {"laser_id": str(laser), TWO_POINT: "true" if two_point[laser] else "false"}
        lines.append("- {" + ", ".join(f"{key}: {fields[key]}" for key in sorted(fields)) + "}")
    lines += [f"num_lasers: {number}", f"distance_resolution: {range_step_m}", ""]
    return "\n".join(lines)


def _decimals(step: float) -> int:
    return DECIMALS.get(step, 0 if step == 1.0 else 6)
