"""Sensors: payload bytes <-> blocks, the model of a sensor, and its calibration."""

from lidarcodec.sensors.calibration import read_calibration, write_calibration, write_db_xml, write_yaml
from lidarcodec.sensors.find import find_calibration, find_sensor
from lidarcodec.sensors.generic import generic_for, generic_sensor, model_of
from lidarcodec.sensors.hdl64 import BLOCK_DTYPE, PACKET_DTYPE, RETURN_DTYPE, BlockFlag, PacketArrays, build, parse
from lidarcodec.sensors.recognise import check_recognised, recognised
from lidarcodec.sensors.status import STATUS_PACKETS, StatusClock, parameter_bytes, status_bytes
from lidarcodec.sensors.status_reader import StatusReader, UnitParameters

__all__ = [
    "BLOCK_DTYPE",
    "PACKET_DTYPE",
    "RETURN_DTYPE",
    "STATUS_PACKETS",
    "BlockFlag",
    "PacketArrays",
    "StatusClock",
    "StatusReader",
    "UnitParameters",
    "build",
    "check_recognised",
    "find_calibration",
    "find_sensor",
    "generic_for",
    "generic_sensor",
    "model_of",
    "parameter_bytes",
    "parse",
    "read_calibration",
    "recognised",
    "status_bytes",
    "write_calibration",
    "write_db_xml",
    "write_yaml",
]
