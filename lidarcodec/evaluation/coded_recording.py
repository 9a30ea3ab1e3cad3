"""CodedRecording: writes frames to a recording as messages of one encoder, optionally with decoded points.

Each message is decoded again before it is written, and compared with the original frames.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import IO, Final, NamedTuple

import numpy as np

from lidarcodec.evaluation.losses import Losses
from lidarcodec.evaluation.round_trip import RoundTrip, check_refined
from lidarcodec.frame import Frame
from lidarcodec.frame_images import payload_bytes
from lidarcodec.layers import RefinableFrame, RefinedFrame
from lidarcodec.layers import unpack as unpack_refinement
from lidarcodec.message import Message
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.recording import RecordingWriter
from lidarcodec.sensors.models.table import aside_name
from lidarcodec.settings import valid_name
from lidarcodec.sources import PacketSource
from lidarcodec.units import PACKET_INTERVAL_US, counted
from lidarcodec.wire import pack

VEHICLE, SENSOR = "vehicle", "lidar"


class Named(NamedTuple):
    """The names that a recording is to have, of the vehicle and of its sensor; None: those of the source."""

    vehicle: str | None = None
    sensor: str | None = None

    @classmethod
    def of(cls, vehicle: str | None, sensor: str | None) -> Named:
        """From `--vehicle` and `--sensor`.

        Raises SettingsError for a name that is not valid.
        """
        given = ((vehicle, "vehicle"), (sensor, "sensor"))
        return cls(*(None if name is None else valid_name(name, what) for name, what in given))

    def known(self, source: PacketSource) -> tuple[str, str]:
        """The names of a recording of this source: those given, those it has, or the usual ones."""
        vehicle, sensor = source.names or (VEHICLE, SENSOR)
        return self.vehicle or vehicle, self.sensor or sensor


UNNAMED: Final = Named()
LONGEST_STEP_NS: Final = 1_000_000_000
"""A longer time between two packets, or frames, is a pause of the drive, or a clock that was set."""


class CodedRecording:
    """Encodes frame by frame. `close` writes the frames that the codec still holds, and the index.

    `write` and `close` raise RoundTripError if a decoded message exceeds the error bounds of the settings.

    frames, packets, positions: numbers of frames, packets and position packets so far
    payload_bytes: size of the packets;  left_out: frames skipped to keep the target bitrate
    seconds: duration of all frames, without pauses between them
    coded: bytes of the messages, refinements included;  refinement_bytes: of the refinements alone
    clouds: whether points are written
    """

    def __init__(
        self,
        handle: IO[bytes],
        encoder: StreamEncoder,
        about: Mapping[str, str],
        *,
        clouds: bool = False,
        vehicle: str = VEHICLE,
        sensor: str = SENSOR,
        compared: Callable[[Frame, Frame], object] = lambda sent, decoded: None,
    ) -> None:
        """compared: called with each frame that was encoded, and as it was decoded again"""
        self._encoder, self.clouds = encoder, clouds
        self._writer = RecordingWriter(handle, vehicle, sensor, encoder.settings, about, clouds=clouds)
        self.losses, self._compared = Losses(), compared
        self._check = RoundTrip(encoder.settings, compared=self._pair)
        self.frames = self.packets = self.positions = self.coded = self.left_out = 0
        self.payload_bytes = self.refinement_bytes = 0
        self._base: tuple[Message, list[Frame]]
        self.seconds = 0.0
        self._aside = ""
        self._last: tuple[int, float] | None = None

    def write(self, frame: Frame) -> None:
        """Encode one frame."""
        messages = self._encoder.encode(frame)
        if self._encoder.left_out:
            self.left_out += 1
        else:
            self.losses.given += frame.points
            self._check.sent(self._encoder.reduced or frame)
        self._put(messages)
        if self._encoder.refinable is not None and not self._encoder.left_out:
            self._refine(self._encoder.refinable)
        self.frames += 1
        if frame.side is not None:
            self.packets += frame.side.packets
            self.positions += len(frame.side.positions)
            self._aside = aside_name(frame.sensor.model)
            self.payload_bytes += payload_bytes(frame)
            self._seconds_of(frame)

    def _seconds_of(self, frame: Frame) -> None:
        if frame.sensor.is_hdl64e:
            self.seconds = self.packets * PACKET_INTERVAL_US * 1e-6
            return
        steps = np.diff(frame.side.packet_ns) if frame.side is not None else np.zeros(0, np.int64)
        own_s = float(steps[(steps > 0) & (steps <= LONGEST_STEP_NS)].sum()) * 1e-9
        if self._last is not None:  # until here the last frame had only the time between its own packets
            last_ns, last_s = self._last
            step = frame.stamp_ns - last_ns
            self.seconds += step * 1e-9 - last_s if 0 < step <= LONGEST_STEP_NS else 0.0
        self.seconds += own_s
        self._last = frame.stamp_ns, own_s

    def close(self) -> None:
        """End the recording, not the file."""
        self._put(self._encoder.flush())
        self._show(self._check.end())
        self._writer.write_losses(self.losses.texts(self.left_out))
        self._writer.close()

    def summary(self, again: int | None = None) -> str:
        """Numbers of frames and bytes, in a line. again: bytes of the messages that were coded again, 0 if unknown"""
        size, what = (self.payload_bytes, "packets") if again is None else (again, "messages")
        ratio = f", ratio {size / self.coded:.2f}" * (not self.left_out)  # else it would count what is not there
        coded = f"{size:,} bytes of {what} in {self.coded:,} bytes{ratio}" if size else f"{self.coded:,} bytes"
        left = f" (and {self.left_out:,} left out to keep the target)" * bool(self.left_out)
        positions = f"{counted(self.positions, self._aside)}, " * bool(self.positions)
        compared = f", all decoded again and compared{self.losses.text()}"
        return f"{counted(self.frames - self.left_out, 'frame')}{left}, {positions}{coded}{compared}"

    def _pair(self, sent: Frame, decoded: Frame) -> None:
        if self._encoder.refinable is None:  # else the refined frame is compared
            self.losses.compare(sent, decoded)
        self._compared(sent, decoded)

    def _put(self, messages: list[Message]) -> None:
        for message in messages:
            frames = self._check.message(data := pack(message))
            self._writer.write(data)
            self.coded += len(data)
            if self._encoder.refinable is None:
                self._show(frames)
            else:
                self._base = (message, frames)

    def _refine(self, refinable: RefinableFrame) -> None:
        """Write the refinements of the frame whose base was written last."""
        message, (base,) = self._base
        refined = RefinedFrame(base, message)
        for sector in refinable.sectors:
            data = refinable.code(sector)
            refined.add(unpack_refinement(data))
            self._writer.write_refinement(data)
            self.refinement_bytes += len(data)
            self.coded += len(data)
        frame = refined.frame()
        check_refined(frame, refinable)
        self.losses.compare(refinable.frame, frame)
        self._show([frame])

    def _show(self, frames: list[Frame]) -> None:
        for frame in frames if self.clouds else []:  # decoded frames, so that viewers show losses
            self._writer.write_cloud(frame)
