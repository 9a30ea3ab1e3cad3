"""`jpeg-layered`: several turns as one JPEG in which the rows of each laser are times (Tu 2016's "layer JPEG").

The frames of a group go into one message when the group is full, so the first waits for `group` - 1 others: 0.8 s with
the default of 8 and frames of 0.1 s. Groups are independent: a lost message loses only its own frames. A requested key
frame, another sensor, or the end of the stream ends a group early. New settings do not: they apply to the group in
progress. With a target bitrate the quality is found when a group ends, by coding it more than once.

A RANGE section, there is one in a message, is the head of the group (group_head.py) and, if there is any return, what
samples mean (jpeg_samples.py) and the JPEG. Of other sensors than the HDL-64E the head of pictures.py comes first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from pydantic import Field

from lidarcodec.codecs.base import Codec, InForce, Others, Steering
from lidarcodec.codecs.frame_decoder import PlaneReader, check_codec
from lidarcodec.codecs.frame_encoder import check_same_codec
from lidarcodec.codecs.jpeg_samples import JpegSettings, ranges_of, split_samples, with_samples
from lidarcodec.codecs.other_decoder import PlaneDecoder
from lidarcodec.codecs.pictures import READ_AS, cells_of, coded_images, head_of, split_head, with_ranges
from lidarcodec.codecs.plane_content import frame_sections
from lidarcodec.codecs.rate_knob import quality_knob
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.frame_images import layout_of
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.motion.history import MaskHistory
from lidarcodec.planes.calibrations import encode_calibration
from lidarcodec.planes.intensity import Quality
from lidarcodec.planes.plane_section import read_head
from lidarcodec.planes.sections import encode_planes
from lidarcodec.ranges.image.group_head import pack_group, packets_in, split_group
from lidarcodec.ranges.image.jpeg_file import read_jpeg
from lidarcodec.ranges.image.layers import group_fits, layers_of
from lidarcodec.ranges.mapping import CANVAS, Scale
from lidarcodec.settings import StreamSettings
from lidarcodec.units import LASERS

Mask = npt.NDArray[np.bool_]

MAX_GROUP = 32
MAX_NUMBERS: Final = 1 << 26
"""Numbers of all planes of a group of other sensors, at most: they are decoded before the picture."""


class LayeredSettings(JpegSettings):
    """Settings of `jpeg-layered`."""

    group: int = Field(default=8, ge=1, le=MAX_GROUP)
    """Number of frames that are coded together. 8 fit the rows of JPEG blocks; the paper uses 10."""


@dataclass(frozen=True, eq=False)
class _Member:
    """A frame that waits for its group. All sections except its ranges are already coded.

    known: (H, W) bool, its returns; ranges: (H, W), of these; azimuth: (W,), 0.01 degree; bits: of a range
    W are the columns that are sent.
    """

    frame: Frame
    sections: list[Section]
    known: Mask
    ranges: npt.NDArray[np.unsignedinteger]
    azimuth: npt.NDArray[np.uint16]
    bits: int = 16
    numbers: int = 0
    """Of all planes, of another sensor than an HDL-64E."""


class LayeredEncoder:
    """Encoder of `jpeg-layered`."""

    def __init__(self, codec_id: int, settings: StreamSettings, stream_id: int, *, others: bool = False) -> None:
        """others: of frames of other sensors than the HDL-64E"""
        self.codec_id, self.stream_id, self._others = codec_id, stream_id, others
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
        member = other_member(frame, self._settings.stream) if self._others else self._member(frame)
        if self._members and sum(one.numbers for one in self._members) + member.numbers > MAX_NUMBERS:
            self._close()
        if not self._members:
            sensor = (frame.sensor.hash, frame.sensor.convention)
            self._key = key or sensor != self._sensor or self._key_is_due()
            self._sensor = sensor
        self._members.append(member)
        if len(self._members) >= self._settings.own.group:
            self._close()
        return self._taken()

    def flush(self) -> list[Message]:
        """The message of the group that was not yet full."""
        if self._members:
            self._close()
        return self._taken()

    def _member(self, frame: Frame) -> _Member:
        """A frame of an HDL-64E. Its mask refers to those before in the group."""
        if not self._members:
            self._history = MaskHistory()
        previous = self._history.before(frame.azimuth, frame.sensor) if self._members else None
        planes = encode_planes(frame, Quality.of(self._settings.stream), previous)
        self._history.remember(frame.valid, frame.azimuth, frame.sensor)
        return _Member(frame, planes, frame.valid, frame.range_u16, frame.azimuth[0])

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
            for section in member.sections
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
                planes=self._others,
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
        last, widest = self._members[-1].frame, max(len(member.azimuth) for member in self._members)
        return (
            len(self._members) >= self._settings.own.group
            or (frame.sensor.hash, frame.sensor.convention) != self._sensor
            or not 0 < frame.index - last.index < 2**16
            or not group_fits(len(self._members) + 1, max(widest, frame.width), frame.sensor.rows)
        )

    def _coder(self, members: list[_Member]) -> Callable[[StreamSettings], bytes]:
        """A function that gives the RANGE section for some settings. It uses only the JPEG settings."""
        frames, in_force = [member.frame for member in members], self._settings
        sensor, bits = frames[0].sensor, max(member.bits for member in members)
        scale = scale_of(bits, sensor.range_step_m) if self._others else CANVAS
        layers = layers_of([member.azimuth for member in members], sensor.rows)
        head = (head_of(bits, 1) if self._others else b"") + pack_group(frames, layers)
        known = layers.spread([member.known for member in members]) if layers.samples else np.zeros((0, 0), np.bool_)
        if not known.any():
            return lambda _: head
        values = layers.spread([np.where(member.known, member.ranges, 0).astype(np.int32) for member in members])

        def code(settings: StreamSettings) -> bytes:
            own = InForce.of(LayeredSettings, settings, in_force).own
            samples, jpeg = with_samples(own, values, known, scale)
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
        group = split_group(message.section(SectionType.RANGE), message)
        alone, rest = group.alone, group.rest
        layers = group.layers([one.width for one in alone], LASERS)
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


def other_member(frame: Frame, stream: StreamSettings) -> _Member:
    """A frame of another sensor than an HDL-64E."""
    found = layout_of(frame)
    if found is None:
        nothing, rows = np.zeros(0, np.uint16), frame.sensor.rows
        empty = np.zeros((rows, 0), np.uint16)
        return _Member(frame, frame_sections(frame, []), empty.astype(np.bool_), empty, nothing, 1)
    coded = coded_images(frame, found[1], stream, exact=False)
    sections = frame_sections(frame, [Section(SectionType.PLANES, coded.planes)])
    cells = coded.cells
    numbers = frame.range.size * len(found[1].planes)
    return _Member(frame, sections, cells.known, coded.numbers, cells.azimuth, cells.bits, numbers)


def scale_of(bits: int, step_m: float) -> Scale:
    """The scale of ranges of so many bits, of a sensor with that range step."""
    return Scale.of((1 << bits) - 1, step_m)


def _numbers_of(message: Message) -> int:
    """Numbers of the planes of a frame, before they are decoded. Raises SectionError or TruncatedError."""
    if not message.has(SectionType.PLANES):
        return 0
    head = read_head(message.section(SectionType.PLANES))
    return head.rows * message.width * len(head.forms)


class OtherLayeredDecoder:
    """Decoder of `jpeg-layered` of frames of other sensors than the HDL-64E."""

    def __init__(self, codec_id: int) -> None:
        self.codec_id = codec_id
        self._planes = PlaneDecoder(READ_AS)

    def decode(self, message: Message) -> list[Frame]:
        """The frames of the message.

        Raises DecodeError; MissingReferenceError when a key message has to come first.
        """
        check_codec(message, self.codec_id)
        if message.frame_count > MAX_GROUP or message.needs is not None:
            raise SectionError(f"a group of {message.frame_count} frames that needs frame {message.needs}")
        bits, step, data = split_head(message.section(SectionType.RANGE))
        group = split_group(data, message)
        if step != 1:
            raise SectionError(f"a group of frames with a range step of {step}")
        numbers = sum(_numbers_of(one) for one in group.alone)
        if numbers > MAX_NUMBERS:
            raise SectionError(f"a group of {numbers} numbers in planes: {MAX_NUMBERS} are possible")
        calibration = Section(SectionType.CALIBRATION, message.section(SectionType.CALIBRATION))
        frames: list[Frame] = []
        for number, one in enumerate(group.alone):
            sections = one.sections if number == 0 else (calibration, *one.sections)
            frames += self._planes.decode(replace(one, codec=READ_AS, sections=sections))
        cells = [cells_of(frame, one, bits) for frame, one in zip(frames, group.alone, strict=True)]
        if not any(of.known.any() for of in cells):
            if group.rest:
                raise SectionError(f"{len(group.rest)} bytes of ranges for no return")
            samples: list[npt.NDArray[Any]] = [np.zeros(of.known.shape, np.uint16) for of in cells]
        else:
            rows = frames[0].sensor.rows
            layers = group.layers([of.known.shape[1] for of in cells], rows)
            depth, value_of, jpeg = split_samples(group.rest, scale_of(bits, frames[0].sensor.range_step_m))
            samples = layers.gather(value_of[read_jpeg(jpeg, *layers.shape, depth)])
        return [with_ranges(frame, image, 1, bits, exact=False) for frame, image in zip(frames, samples, strict=True)]

    def flush(self) -> list[Frame]:
        """Nothing: a group comes whole."""
        return []


CODEC = Codec(
    LayeredSettings,
    LayeredEncoder,
    LayeredDecoder,
    bounded=False,
    knob=quality_knob(),
    rolling=False,
    others=Others(partial(LayeredEncoder, others=True), OtherLayeredDecoder),
)
