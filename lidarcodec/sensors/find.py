"""The calibration of a source: given, beside the capture, in the stream, or a generic one, in this order."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

from lidarcodec.budgets import FileTooLargeError, read_file
from lidarcodec.errors import CalibrationError
from lidarcodec.sensor_model import HDL64E, POINTCLOUD2, Origin, SensorModel
from lidarcodec.sensors.calibration import read_calibration
from lidarcodec.sensors.calibration_kinds import check_maker
from lidarcodec.sensors.capture_names import is_file, stem_of
from lidarcodec.sensors.clouds.sensor import cloud_sensor
from lidarcodec.sensors.generic import generic_for
from lidarcodec.sensors.images import Sensor
from lidarcodec.sensors.models.ouster.beside import metadata_beside
from lidarcodec.sensors.models.ouster.sensor import model_from, sensor_from
from lidarcodec.sensors.models.table import OUSTERS, PACKETS, any_packets, detect, is_ouster, sensor_named
from lidarcodec.sensors.status_reader import StatusReader
from lidarcodec.units import PACKET_BYTES

logger = logging.getLogger(__name__)


def find_sensor(
    capture: Path | None, given: Path | None, first_payloads: Sequence[bytes], model: str | None = None
) -> SensorModel:
    """The sensor of a source: its model, as named or as the packets show it, and its calibration as found.

    Raises CalibrationError if the given file is not the calibration of that model, UnknownNameError.
    """
    if model is None:
        found = detect(first_payloads)
        model = HDL64E if found is None else found.model
    if given is not None and model not in (PACKETS, POINTCLOUD2):
        check_maker(_read(given), model, str(given))
    if model == HDL64E:
        return find_calibration(capture, given, first_payloads)
    if model == PACKETS:
        return any_packets()
    if model == POINTCLOUD2:
        return cloud_sensor(first_payloads)
    if is_ouster(model):
        return _ouster(capture, given, first_payloads, model)
    return _of_model(sensor_named(model), capture, given)


def _of_model(family: Sensor, capture: Path | None, given: Path | None) -> SensorModel:
    """A sensor with the calibration that was given, lies beside the capture, or is nominal."""
    if given is not None:
        return family.calibrated(_read(given), "given", str(given))
    for path in beside(capture) if capture is not None else ():
        try:
            data = _read(path)
            check_maker(data, family.name, str(path))
            return family.calibrated(data, "beside", str(path))
        except CalibrationError as error:
            logger.warning("not used: %s", error)
    return family.generic_sensor


def _ouster(capture: Path | None, given: Path | None, payloads: Sequence[bytes], model: str) -> SensorModel:
    """An Ouster with the metadata that was given or lies beside the capture; without any, one of bare packets."""
    origin: Origin = "beside" if given is None else "given"
    path = metadata_beside(capture, payloads) if given is None and capture is not None else given
    if path is None:
        return sensor_named(model).generic_sensor
    metadata = _read(path)
    try:
        found = model_from(metadata, origin)
    except CalibrationError as error:
        raise CalibrationError(f"metadata {path}: {error}") from error
    size = sensor_from(metadata).layout.packet_bytes
    if payloads and all(len(payload) != size for payload in payloads):
        sent = len(payloads[0])
        raise CalibrationError(
            f"metadata {path} is of an {found.model} that sends packets of {size} bytes, but these have {sent}: "
            "give the metadata from the time of the recording"
        )
    if model in OUSTERS and model != found.model:
        raise CalibrationError(f"metadata {path} is of an {found.model}, not of an {model}")
    logger.info("metadata of %s from %s", found.name, path)
    return found


def find_calibration(capture: Path | None, given: Path | None, first_payloads: Sequence[bytes]) -> SensorModel:
    """The HDL-64E of a source; its `origin` says where the calibration was found.

    given:   the file that the user named; it must be readable
    beside:  `NAME_db.xml`, `NAME.yaml` or `db.xml` beside the capture; NAME is the capture's name without its endings.
             A file that is not the calibration of an HDL-64E is skipped with a warning
    stream:  the table in the status bytes of `first_payloads`, if it is complete there (4160 packets or more)
    generic: a published table of the model that `first_payloads` look like
    Raises CalibrationError if the given file is not the calibration of an HDL-64E.
    """
    if given is not None:
        return read_calibration(given, "given")
    for path in beside(capture) if capture is not None else ():
        try:
            sensor = read_calibration(path, "beside")
        except CalibrationError as error:
            logger.warning("not used: %s", error)
            continue
        logger.info("calibration of %s from %s", capture, path)
        return sensor
    return _of_stream(first_payloads) or generic_for(first_payloads)


def beside(capture: Path) -> Iterator[Path]:
    """Existing calibration files beside a capture (or in it, if it is a folder), in order of preference.

    The endings of capture and compression are removed: the name of `drive.pcap.xz` is `drive`.
    """
    name = stem_of(capture)
    names = (f"{name}_db.xml", f"{name}.yaml", f"{name}.csv", "db.xml")
    candidates = [capture.parent / one for one in names]
    if capture.is_dir():
        candidates.insert(0, capture / "db.xml")
    for candidate in candidates:
        if candidate != capture and is_file(candidate):
            yield candidate


def _read(path: Path) -> bytes:
    try:
        return read_file(path, "calibration")
    except OSError as error:
        raise CalibrationError(f"cannot read calibration {path}: {error.strerror or error}") from error
    except FileTooLargeError as error:
        raise CalibrationError(f"calibration {path}: {error}: this is not a calibration file") from None


def _of_stream(payloads: Sequence[bytes]) -> SensorModel | None:
    reader = StatusReader()
    for payload in payloads:
        if len(payload) == PACKET_BYTES and reader.push(payload):
            return reader.sensor
    return None
