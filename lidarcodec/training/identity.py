"""Digest of the contents of a source, because a changed file can have the same name."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from itertools import islice
from typing import Any, Final

import numpy.typing as npt

from lidarcodec.api import read_frames
from lidarcodec.errors import SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.spec import parse

_AT_ONCE: Final = 1 << 20


def digest_of(arrays: Iterable[npt.NDArray[Any]]) -> str:
    """A digest of training data; 16 hexadecimal digits."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(array.tobytes())
    return found.hexdigest()[:16]


def identity(source: PacketSource, spec: str) -> str:
    """A digest of the calibration, the poses and the contents of a source; 16 hexadecimal digits.

    spec: text that opened the source. A file is read as bytes, a folder as packets, both to their end, because an
    incomplete copy of a capture begins with the same frames. For a simulated drive the first frame is enough, because
    its name describes the rest. Raises errors of the source, SourceError.
    """
    found, parsed = hashlib.sha256(source.sensor.hash.encode()), parse(spec)
    if parsed.scheme:
        for frame in islice(read_frames(source), 1):
            found.update(frame.range_u16.tobytes() + frame.intensity.tobytes())
    elif parsed.path.is_file():
        try:
            with open_regular(parsed.path) as file:
                while part := file.read(_AT_ONCE):
                    found.update(part)
        except OSError as error:
            raise SourceError(f"cannot read {parsed.path}: {error.strerror or error}") from None
    else:
        for packet in source.packets():
            found.update(packet.stamp_ns.to_bytes(16, "little", signed=True) + packet.payload)
    if (poses := source.poses) is not None:
        for stamp_ns in poses.stamps_ns.tolist():
            found.update(f"{stamp_ns} {poses.at(stamp_ns)}".encode())
    return found.hexdigest()[:16]
