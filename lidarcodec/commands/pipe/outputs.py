"""What goes to standard output, written and flushed frame by frame.

`points`: of each frame its stamp (i64, ns since 1970), the number of points (u32), the bytes of a point (u32: 16), and
the points: x y z in metres and intensity, float32. All little endian.
"""

from __future__ import annotations

import logging
import struct
from typing import Final, Protocol

import numpy as np

from lidarcodec.assembly import packets_of
from lidarcodec.cloud import second_returns
from lidarcodec.errors import DecodeError
from lidarcodec.files.counting import Counting
from lidarcodec.frame import Frame
from lidarcodec.frame_images import layout_of
from lidarcodec.recording import RecordingWriter
from lidarcodec.sources.captures.pcap_writer import PcapWriter

logger = logging.getLogger(__name__)

_SIZE: Final = struct.Struct("<I")
_CLOUD: Final = struct.Struct("<qII")
_POINT: Final = 16


class MessageOutput(Protocol):
    """Takes messages. close: completes the output, which stays open"""

    def write(self, data: bytes) -> None: ...

    def close(self) -> None: ...


class Prefixed:
    """Messages, each with its size before it (u32, little endian), as clients/cpp/print_points reads them."""

    def __init__(self, out: Counting) -> None:
        self._out = out

    def write(self, data: bytes) -> None:
        self._out.write(_SIZE.pack(len(data)) + data)
        self._out.flush()

    def close(self) -> None:
        """Nothing is left to write."""


class Recorded:
    """Messages in a recording. It has no end before `close`, but all before it can be read."""

    def __init__(self, out: Counting, vehicle: str, sensor: str) -> None:
        self._out = out
        self._writer = RecordingWriter(out, vehicle, sensor)  # type: ignore[arg-type]

    def write(self, data: bytes) -> None:
        self._writer.write(data)

    def close(self) -> None:
        self._writer.close()
        self._out.flush()


class FrameOutput(Protocol):
    """Takes frames."""

    def write(self, frame: Frame) -> bool:
        """Write one; whether that was possible."""


class Captured:
    """The packets of frames, as a pcap."""

    def __init__(self, out: Counting) -> None:
        self._out, self._writer = out, PcapWriter(out)  # type: ignore[arg-type]

    def write(self, frame: Frame) -> bool:
        try:
            packets = packets_of(frame)
        except DecodeError:
            return False
        for packet in packets:
            self._writer.write(packet)
        self._out.flush()
        return True


class Clouds:
    """The points of frames, of first returns. points: written so far;  second: second returns left out"""

    def __init__(self, out: Counting) -> None:
        self._out, self.points, self.second, self._warned = out, 0, 0, False

    def write(self, frame: Frame) -> bool:
        if not _has_points(frame):
            if not self._warned:
                logger.warning("no points can be made of packets of %s: their layout is not known", frame.sensor.name)
            self._warned = True
            return False
        cloud = frame.cloud()
        points = np.stack([cloud[name].astype("<f4") for name in ("x", "y", "z", "intensity")], axis=1)
        self._out.write(_CLOUD.pack(frame.stamp_ns, len(points), _POINT) + points.tobytes())
        self._out.flush()
        self.points += len(points)
        self.second += second_returns(frame)
        return True


def _has_points(frame: Frame) -> bool:
    """Whether points can be made of a frame; it may have none. No packet of another one has a known layout."""
    return frame.sensor.is_hdl64e or frame.sensor.is_cloud or layout_of(frame) is not None
