"""What a source holds, in sixteen digits: a file that was changed keeps its name."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from itertools import islice
from typing import Any

import numpy.typing as npt

from lidarcodec.api import read_frames
from lidarcodec.sources.base import PacketSource


def digest_of(arrays: Iterable[npt.NDArray[Any]]) -> str:
    """A digest of what a network is trained on; 16 hexadecimal digits."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(array.tobytes())
    return found.hexdigest()[:16]


def identity(source: PacketSource) -> str:
    """A digest of the calibration, the poses and the first frame of a source; 16 hexadecimal digits.

    Raises what the source raises.
    """
    found = hashlib.sha256(source.sensor.hash.encode())
    for frame in islice(read_frames(source), 1):
        found.update(frame.range.tobytes() + frame.intensity.tobytes())
    if (poses := source.poses) is not None:
        for stamp_ns in poses.stamps_ns.tolist():
            found.update(f"{stamp_ns} {poses.at(stamp_ns)}".encode())
    return found.hexdigest()[:16]
