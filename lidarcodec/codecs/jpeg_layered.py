"""`jpeg-layered`: several turns as one JPEG in which the rows of each laser are times (Tu 2016's "layer JPEG").

The frames of a group go into one message when the group is full, so the first waits for `group` - 1 others: 0.8 s with
the default of 8 and frames of 0.1 s. Groups are independent: a lost message loses only its own frames. A requested key
frame, another sensor, or the end of the stream ends a group early. New settings do not: they apply to the group in
progress. With a target bitrate the quality is found when a group ends, by coding it more than once.

A RANGE section, there is one in a message, is the head of the group (group_head.py) and, if there is any return, what
samples mean (jpeg_samples.py) and the JPEG.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from pydantic import Field

from lidarcodec.codecs.base import Codec, InForce, Steering
from lidarcodec.codecs.frame_decoder import PlaneReader, check_codec
from lidarcodec.codecs.frame_encoder import check_same_codec
from lidarcodec.codecs.jpeg_samples import JpegSettings, ranges_of, split_samples, with_samples
from lidarcodec.codecs.rate_knob import quality_knob
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.motion.history import MaskHistory
from lidarcodec.planes.calibrations import encode_calibration
from lidarcodec.planes.intensity import Quality
from lidarcodec.planes.sections import encode_planes
from lidarcodec.ranges.image.group_head import pack_group, packets_in, split_group
from lidarcodec.ranges.image.jpeg_file import read_jpeg
from lidarcodec.ranges.image.layers import group_fits, layers_of
from lidarcodec.settings import StreamSettings
from lidarcodec.units import LASERS

Mask = npt.NDArray[np.bool_]

MAX_GROUP = 32


class LayeredSettings(JpegSettings):
    """Settings of `jpeg-layered`."""

    group: int = Field(default=8, ge=1, le=MAX_GROUP)
    """Number of frames that are coded together. 8 fit the rows of JPEG blocks; the paper uses 10."""


@dataclass(frozen=True, eq=False)
class _Member:
    """A frame that waits for its group. All sections except its ranges are already coded."""

    frame: Frame
    valid: Mask
    planes: list[Section]


class LayeredEncoder:
    """Encoder of `jpeg-layered`."""

    def __init__(self, codec_id: int, settings: StreamSettings, stream_id: int) -> None:
        self.codec_id, self.stream_id = codec_id, stream_id
        self._settings = InForce.of(LayeredSettings, settings)
        self._members: list[_Member] = []
        self._ready: list[Message] = []
        self._key = False
        self._since_key: int | None = None
        self._sensor: tuple[str, str] | None = None
        self._history = MaskHistory()
        self._steering: Steering | None = None

    def steer(self, steering: Steering | None) -> None:
        """Ask `steering` for the quality of each group from now on; None: use the settings."""
        self._steering = steering

    def apply(self, settings: StreamSettings) -> bool:
        """Takes new settings for the group in progress; True: the next message will be a key message.

        Only `intensity` is coded frame by frame, and so holds from the next frame on.

        Raises SettingsError for another codec: that takes another encoder.
        """
        check_same_codec(self._settings.stream, settings)
        self._settings = InForce.of(LayeredSettings, settings, self._settings)
        return self._key if self._members else self._key_is_due()

    def encode(self, frame: Frame, *, key: bool = False) -> list[Message]:
        """The message of the group that this frame completes, and of one that ends before it.

        Raises LidarCodecError for a frame that contradicts itself; the group goes on without it.
        """
        if self._members and (key or self._ends_before(frame)):
            self._close()
        if not self._members:
            self._history = MaskHistory()
        previous = self._history.before(frame.azimuth, frame.sensor) if self._members else None
        planes = encode_planes(frame, Quality.of(self._settings.stream), previous)
        self._history.remember(frame.valid, frame.azimuth, frame.sensor)
        if not self._members:
            sensor = (frame.sensor.hash, frame.sensor.convention)
            self._key = key or sensor != self._sensor or self._key_is_due()
            self._sensor = sensor
        self._members.append(_Member(frame, frame.valid, planes))
        if len(self._members) >= self._settings.own.group:
            self._close()
        return self._taken()

    def flush(self) -> list[Message]:
        """The message of the group that was not yet full."""
        if self._members:
            self._close()
        return self._taken()

    def _taken(self) -> list[Message]:
        ready, self._ready = self._ready, []
        return ready

    def _close(self) -> None:
        """Makes a message of the group. It waits in `_ready`, also when the frame that ended the group is refused."""
        members, self._members = self._members, []
        frames = [member.frame for member in members]
        first, code = frames[0], self._coder(members)
        calibration = Section(SectionType.CALIBRATION, encode_calibration(first.sensor, self._key))
        planes = [
            section._replace(ordinal=ordinal)
            for ordinal, member in enumerate(members)
            for section in member.planes
        ]  # fmt: skip

        def message(ranges: bytes) -> Message:
            return Message(
                codec=self.codec_id,
                stream_id=self.stream_id,
                frame_index=first.index,
                stamp_ns=first.stamp_ns,
                key=self._key,
                width=max(frame.width for frame in frames),
                packets=max(packets_in(frame) for frame in frames),
                sections=(calibration, Section(SectionType.RANGE, ranges), *planes),
                frame_count=len(frames),
            )

        steered = None if self._steering is None else self._steering.range_of(frames, message(b""), code)
        self._ready.append(message(code(self._settings.stream) if steered is None else steered))
        self._since_key = len(frames) if self._key else (self._since_key or 0) + len(frames)

    def _key_is_due(self) -> bool:
        """Whether a group that begins now must be a key message, because the next group would be too late."""
        return (
            self._since_key is None or self._since_key + self._settings.own.group > self._settings.stream.key_interval
        )

    def _ends_before(self, frame: Frame) -> bool:
        last, widest = self._members[-1].frame, max(member.frame.width for member in self._members)
        return (
            len(self._members) >= self._settings.own.group
            or (frame.sensor.hash, frame.sensor.convention) != self._sensor
            or not 0 < frame.index - last.index < 2**16
            or not group_fits(len(self._members) + 1, max(widest, frame.width))
        )

    def _coder(self, members: list[_Member]) -> Callable[[StreamSettings], bytes]:
        """A function that gives the RANGE section for some settings. It uses only the JPEG settings."""
        frames, in_force = [member.frame for member in members], self._settings
        layers = layers_of([frame.azimuth[0] for frame in frames])
        head = pack_group(frames, layers)
        known = layers.spread([member.valid for member in members]) if layers.samples else np.zeros((0, 0), np.bool_)
        if not known.any():
            return lambda _: head
        values = layers.spread([np.where(member.valid, member.frame.range_u16, 0) for member in members]).astype(
            np.int32
        )

        def code(settings: StreamSettings) -> bytes:
            own = InForce.of(LayeredSettings, settings, in_force).own
            samples, jpeg = with_samples(own, values, known)
            return head + samples + jpeg

        return code


class LayeredDecoder:
    """Decoder of `jpeg-layered`."""

    def __init__(self, codec_id: int) -> None:
        self.codec_id = codec_id
        self._planes = PlaneReader(codec_id, reads_ranges=True)

    def decode(self, message: Message) -> list[Frame]:
        """The frames of the message.

        Raises DecodeError; MissingReferenceError when a key message has to come first.
        """
        check_codec(message, self.codec_id)
        if message.frame_count > MAX_GROUP or message.needs is not None:
            raise SectionError(f"a group of {message.frame_count} frames that needs frame {message.needs}")
        alone, layers, rest = split_group(message.section(SectionType.RANGE), message)
        calibration = Section(SectionType.CALIBRATION, message.section(SectionType.CALIBRATION))
        planes = [self._planes.read(alone[0])]
        for before, one in pairwise(alone):
            sections = (calibration, *one.sections)
            planes.append(self._planes.read(replace(one, needs=before.frame_index, key=False, sections=sections)))
        if any(plane.valid.any() for plane in planes):
            bits, value_of, jpeg = split_samples(rest)
            image = read_jpeg(jpeg, *layers.shape, bits)
            level = np.zeros(LASERS, np.int32)
            for plane, samples in zip(planes, layers.gather(image), strict=True):
                plane.ranges[plane.valid] = ranges_of(value_of[samples], level, plane.valid)
        elif rest:
            raise SectionError(f"{len(rest)} bytes of ranges for no return")
        return [plane.frame(one) for one, plane in zip(alone, planes, strict=True)]

    def flush(self) -> list[Frame]:
        """Nothing: a group comes whole."""
        return []


CODEC = Codec(LayeredSettings, LayeredEncoder, LayeredDecoder, bounded=False, knob=quality_knob(), rolling=False)
