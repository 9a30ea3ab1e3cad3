"""The calibration of a source: given, beside the capture, in the stream, or a generic one, in this order."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

from lidarcodec.errors import CalibrationError
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.calibration import read_calibration
from lidarcodec.sensors.generic import generic_for
from lidarcodec.sensors.status_reader import StatusReader
from lidarcodec.units import PACKET_BYTES

log = logging.getLogger(__name__)

COMPRESSIONS = frozenset({".xz", ".zst", ".gz", ".bz2", ".lz4"})


def find_calibration(capture: Path | None, given: Path | None, first_payloads: Sequence[bytes]) -> SensorModel:
    """The sensor of a source; its `origin` says where the calibration was found.

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
            log.warning("not used: %s", error)
            continue
        log.info("calibration of %s from %s", capture, path)
        return sensor
    return _of_stream(first_payloads) or generic_for(first_payloads)


def beside(capture: Path) -> Iterator[Path]:
    """Existing calibration files beside a capture (or in it, if it is a folder), in order of preference.

    The endings of capture and compression are removed: the name of `drive.pcap.xz` is `drive`.
    """
    name = capture.name
    if not capture.is_dir():
        stem = capture.with_suffix("") if capture.suffix.lower() in COMPRESSIONS else capture
        name = stem.stem
    candidates = [capture.parent / f"{name}_db.xml", capture.parent / f"{name}.yaml", capture.parent / "db.xml"]
    if capture.is_dir():
        candidates.insert(0, capture / "db.xml")
    for candidate in candidates:
        if candidate != capture and _is_file(candidate):
            yield candidate


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # the name is too long
        return False


def _of_stream(payloads: Sequence[bytes]) -> SensorModel | None:
    reader = StatusReader()
    for payload in payloads:
        if len(payload) == PACKET_BYTES and reader.push(payload):
            return reader.sensor
    return None
