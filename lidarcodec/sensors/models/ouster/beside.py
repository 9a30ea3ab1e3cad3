"""The metadata of an Ouster beside a capture of its packets.

`NAME.json` for the capture `NAME.pcap`, or `NAME.pcap.xz`. Else another `.json` in that folder, if it can only be the
right one: packets of the capture have its size and, where they carry one, its serial number, and no other such file has
as many parts in common with NAME from its beginning, at least one. Parts end at `_`, `.` or a space.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from lidarcodec.budgets import FileTooLargeError, read_file
from lidarcodec.errors import CalibrationError
from lidarcodec.sensors.capture_names import is_file, stem_of
from lidarcodec.sensors.models.ouster.metadata import OusterMetadata, read_metadata

logger = logging.getLogger(__name__)

MAX_OTHERS: Final = 64
"""Most other files that are opened."""
_SEPARATORS: Final = re.compile(r"[_. ]+")


def metadata_beside(capture: Path, payloads: Sequence[bytes]) -> Path | None:
    """The file with the metadata of the sensor that sent a capture; None if there is none.

    payloads: of its first packets. What is beside the capture and cannot be used is skipped with a warning.
    """
    name = stem_of(capture)
    own = capture.parent / f"{name}.json"
    if is_file(own):
        read = _read(own)
        if read is not None and fits(read, payloads):
            return own
        logger.warning("%s is not used, because it is not the metadata of the Ouster that sent %s", own, capture)
    for paths in _like(capture.parent, name, own):
        fitting = [path for path in paths if (read := _read(path)) is not None and fits(read, payloads)]
        if len(fitting) > 1:
            logger.warning(
                "%s are not used, because each could be the metadata of %s: give one with --calibration",
                ", ".join(map(str, fitting)),
                capture,
            )
        if fitting:
            return fitting[0] if len(fitting) == 1 else None
    return None


def fits(metadata: OusterMetadata, payloads: Sequence[bytes]) -> bool:
    """Whether some packets have the size that metadata says, and those that name their sensor's serial number its."""
    layout = metadata.layout
    packets = [payload for payload in payloads if len(payload) == layout.packet_bytes]
    if not packets or layout.legacy or metadata.serial == 0:
        return bool(packets)
    numbers = layout.numbers(np.frombuffer(b"".join(packets), np.uint8).reshape(len(packets), -1))
    serials = {int(serial) for serial in numbers["serial"]} - {0}
    return serials <= {metadata.serial}


def _like(folder: Path, name: str, own: Path) -> Iterator[list[Path]]:
    """Other files `.json`, those first whose names have most parts in common with `name`; one part at least."""
    by_common: dict[int, list[Path]] = {}
    try:
        others = [path for path in folder.iterdir() if path.suffix.lower() == ".json" and path != own]
    except OSError:
        return
    for path in sorted(others):
        common = _common(_SEPARATORS.split(name), _SEPARATORS.split(path.stem))
        if common:
            by_common.setdefault(common, []).append(path)
    left = MAX_OTHERS
    for common in sorted(by_common, reverse=True):
        if len(by_common[common]) > left:
            return
        left -= len(by_common[common])
        yield by_common[common]


def _common(one: Sequence[str], other: Sequence[str]) -> int:
    """How many parts two names share from the beginning."""
    for number, (left, right) in enumerate(zip(one, other, strict=False)):
        if left != right:
            return number
    return min(len(one), len(other))


def _read(path: Path) -> OusterMetadata | None:
    """The metadata in a file; None if it holds none."""
    try:
        return read_metadata(read_file(path, "calibration"))
    except (OSError, FileTooLargeError, CalibrationError) as error:
        logger.debug("%s: %s", path, error)
        return None
