"""Digest of the contents of a source, because a changed file can have the same name."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Any, Final

import numpy.typing as npt

from lidarcodec.api import read_frames
from lidarcodec.errors import SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.spec import Spec, parse

_AT_ONCE: Final = 1 << 20


Part = bytes | npt.NDArray[Any]


def digest_of(parts: Iterable[Part]) -> str:
    """A digest of the parts together; 16 hexadecimal digits."""
    found = hashlib.sha256()
    for part in parts:
        found.update(part if isinstance(part, bytes) else part.tobytes())
    return found.hexdigest()[:16]


def identity(source: PacketSource, spec: str) -> str:
    """A digest of the calibration, the contents and the poses of a source; 16 hexadecimal digits.

    spec: text that opened the source. A file is read as bytes, a folder as packets, both to their end, because an
    incomplete copy of a capture begins with the same frames. For a simulated drive the first frame is enough, because
    its name describes the rest. Raises errors of the source, SourceError.
    """
    return digest_of(_parts(source, parse(spec)))


def _parts(source: PacketSource, spec: Spec) -> Iterator[Part]:
    yield source.sensor.hash.encode()
    if spec.scheme:
        for frame in islice(read_frames(source), 1):
            yield from (frame.range_u16 if frame.sensor.is_hdl64e else frame.range, frame.intensity)
    elif spec.path.is_file():
        try:
            with open_regular(spec.path) as file:
                yield from iter(lambda: file.read(_AT_ONCE), b"")
        except OSError as error:
            raise SourceError(f"cannot read {spec.path}: {error.strerror or error}") from None
    else:
        for packet in source.packets():
            yield packet.stamp_ns.to_bytes(16, "little", signed=True) + packet.payload
    if (poses := source.poses) is not None:
        for stamp_ns in poses.stamps_ns.tolist():
            yield f"{stamp_ns} {poses.at(stamp_ns)}".encode()
