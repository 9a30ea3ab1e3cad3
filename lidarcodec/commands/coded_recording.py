"""CodedRecording: frames into a recording, as messages of one encoder, with the points they decode to if wanted."""

from __future__ import annotations

from collections.abc import Mapping
from typing import IO

from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.recording import RecordingWriter
from lidarcodec.units import PACKET_BYTES
from lidarcodec.wire import pack

VEHICLE, SENSOR = "vehicle", "lidar"


class CodedRecording:
    """Encodes frame by frame; `close` writes what the codec holds back, and the index.

    frames, packets: taken so far;  coded: bytes of the messages;  clouds: whether points are written
    """

    def __init__(
        self, handle: IO[bytes], encoder: StreamEncoder, about: Mapping[str, str], *, clouds: bool = False
    ) -> None:
        self._encoder, self.clouds = encoder, clouds
        self._writer = RecordingWriter(handle, VEHICLE, SENSOR, encoder.settings, about, clouds=clouds)
        self._decoder = StreamDecoder()
        self.frames = self.packets = self.coded = 0

    def write(self, frame: Frame) -> None:
        """Encode one frame."""
        self._put(self._encoder.encode(frame))
        self.frames += 1
        self.packets += frame.side.packets if frame.side else 0

    def close(self) -> None:
        """End the recording, not the file."""
        self._put(self._encoder.flush())
        self._show(self._decoder.flush() if self.clouds else [])
        self._writer.close()

    def summary(self) -> str:
        """What went in and what came out, in a line."""
        size = self.packets * PACKET_BYTES
        return f"{self.frames} frames, {size:,} bytes of packets in {self.coded:,} bytes, ratio {size / self.coded:.2f}"

    def _put(self, messages: list[Message]) -> None:
        for message in messages:
            self._writer.write(data := pack(message))
            self.coded += len(data)
            if self.clouds:  # what was lost in coding is to be seen, too
                self._show(self._decoder.decode(message))

    def _show(self, frames: list[Frame]) -> None:
        for frame in frames:
            self._writer.write_cloud(frame)
