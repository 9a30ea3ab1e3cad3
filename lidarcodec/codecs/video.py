"""What `h264` and `h264-log` share: frames as pictures of one H.264 stream, each predicted from the one before.

A RANGE section is empty if there is no return, else what samples mean (as in jpeg_samples.py), where cells are
(turn_canvas.py), and an H.264 access unit. A picture that needs no other (IDR) begins the stream of pictures anew: in
each key message, and whenever bits, quality, mapping, farthest range or layout have to change. Messages of other
pictures name the frame that the picture before belongs to: FFmpeg would not notice that one was lost.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from typing import Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import Field

from lidarcodec.codecs.base import CodecSettings, Encoder, InForce
from lidarcodec.codecs.frame_decoder import PlaneReader, check_codec, missing_reference
from lidarcodec.codecs.frame_encoder import Coded, FrameEncoder
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.planes.intensity import Quality
from lidarcodec.planes.sections import encode_planes
from lidarcodec.ranges.image.canvas import MAX_VALUE, level_offsets
from lidarcodec.ranges.image.holes import filled_lines
from lidarcodec.ranges.mapping import NAMES, MappingName, check_top, mapping_of
from lidarcodec.ranges.video.h264_stream import PictureReader, PictureWriter, Preset
from lidarcodec.ranges.video.turn_canvas import TurnLayout, cells, positions
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import StreamSettings

Mask = npt.NDArray[np.bool_]

HEAD: Final = struct.Struct("<BBIHBB")
"""bits u8, mapping u8, top u32, columns u16, bands u8, anchored u8."""
TOP_STEP: Final = 2048
"""Samples reach to a multiple of 4 m: a farthest return that comes and goes must not begin the pictures anew."""


class VideoSettings(CodecSettings):
    """Settings that `h264` and `h264-log` share."""

    crf: float = Field(default=12.0, ge=0.0, le=51.0)
    """Quality of x264: lower is better and larger. 6 more double the quantiser step."""
    bits: Literal[8, 10] = 10
    """Bits of each sample. 8 bits: steps of 0.3 m at 80 m, readable by decoders without High 10."""
    preset: Preset = "fast"
    """Preset of x264. Slower presets give smaller files."""
    mapping: MappingName


class _Stream(NamedTuple):
    """What all pictures from one IDR picture to the next have in common."""

    bits: int
    mapping: MappingName
    top: int
    layout: TurnLayout

    def pack(self) -> bytes:
        layout = self.layout
        return HEAD.pack(
            self.bits, NAMES.index(self.mapping), self.top, layout.columns, layout.bands, int(layout.anchored)
        )


def _split(data: bytes) -> tuple[_Stream, bytes]:
    """Head of a RANGE section, and its access unit.

    Raises SectionError.
    """
    if len(data) < HEAD.size:
        raise SectionError(f"a range section of {len(data)} bytes ends before its pictures are known")
    bits, mapping, top, columns, bands, anchored = HEAD.unpack_from(data)
    if bits not in (8, 10) or mapping >= len(NAMES) or anchored > 1:
        raise SectionError(f"pictures of {bits} bits by mapping {mapping}, anchored {anchored}")
    layout = TurnLayout(columns, bands, bool(anchored))
    return _Stream(bits, NAMES[mapping], check_top(top), layout), data[HEAD.size :]


def _ranges(
    stream: _Stream, samples: npt.NDArray[np.uint16], sensor: SensorModel, valid: Mask
) -> npt.NDArray[np.uint16]:
    """(N,) uint16, ranges of the returns in row order, none of them 0. samples: (N,)."""
    values = mapping_of(stream.mapping, stream.bits, stream.top).value[samples]
    added = np.repeat(level_offsets(sensor), np.count_nonzero(valid, axis=1))
    near: npt.NDArray[np.uint16] = np.clip(values - added, 1, 65535).astype(np.uint16)
    return near


class VideoContent:
    """What a video codec sends of a frame: planes, and a picture of its ranges."""

    _settings: InForce[VideoSettings]

    def __init__(self) -> None:
        self._stream: _Stream | None = None
        self._writer: PictureWriter | None = None
        self._made_for: VideoSettings | None = None
        self._written: int | None = None
        self._farthest = 0

    def take(self, settings: InForce[VideoSettings]) -> bool:
        """Takes settings. Other settings of the codec begin the pictures anew, without a key message."""
        self._settings = settings
        return False

    def code(self, frame: Frame, *, key: bool) -> Coded:
        """Picture and planes of a frame."""
        planes = encode_planes(frame, Quality.of(self._settings.stream))
        valid = frame.valid
        data, needs = self._picture(frame, valid, key) if valid.any() else (b"", None)
        if key and not data:
            self._writer = None
        return Coded([Section(SectionType.RANGE, data), *planes], needs)

    def _picture(self, frame: Frame, valid: Mask, key: bool) -> tuple[bytes, int | None]:
        """The RANGE section, and the index of the frame that it refers to."""
        offsets = level_offsets(frame.sensor)
        values = (frame.range_u16 + offsets[:, None])[valid]
        writer, stream = self._writer_for(frame, int(values.max()), key)
        idr, needs = (key or self._written is None), self._written
        mapped = mapping_of(stream.mapping, stream.bits, stream.top).sample[values]
        where = cells(stream.layout, positions(stream.layout, frame.azimuth, frame.fired), frame.sensor, valid)
        picture = np.zeros(stream.layout.shape, np.float32)
        known = np.zeros(stream.layout.shape, np.bool_)
        picture.reshape(-1)[where] = mapped
        known.reshape(-1)[where] = True
        whole = np.rint(filled_lines(picture, known)).astype(np.uint16)
        try:
            unit = writer.write(whole, idr=idr)
        except Exception:
            self._writer = None
            raise
        self._written = frame.index
        return stream.pack() + unit, None if idr else needs

    def _writer_for(self, frame: Frame, farthest: int, key: bool) -> tuple[PictureWriter, _Stream]:
        """The writer that goes on, or a new one if this frame does not fit what it began with."""
        self._farthest = max(farthest, 0 if key else self._farthest)
        own = self._settings.own
        writer, stream = self._writer if own == self._made_for else None, self._stream
        if writer is None or stream is None or not stream.layout.holds(frame.azimuth, frame.fired):
            layout = TurnLayout.fitting(frame.azimuth, frame.fired)
        else:
            layout = TurnLayout.fitting(frame.azimuth, frame.fired) if key else stream.layout
        top = min(-(-self._farthest // TOP_STEP) * TOP_STEP, MAX_VALUE)
        if stream is not None and not key and self._farthest <= stream.top:
            top = stream.top
        fresh = _Stream(own.bits, own.mapping, top, layout)
        if writer is None or fresh != stream:
            writer = PictureWriter(*layout.shape, own.bits, own.crf, own.preset)
            self._writer, self._made_for, self._stream, self._written = writer, own, fresh, None
        return writer, fresh


def video_encoder(model: type[VideoSettings]) -> Callable[[int, StreamSettings, int], Encoder]:
    """Makes the encoders of a video codec. model: of its own settings."""
    return lambda codec_id, settings, stream_id: FrameEncoder(codec_id, settings, stream_id, model, VideoContent())


class VideoDecoder:
    """Messages to frames, one each; holds the picture reader and whose picture it read last."""

    def __init__(self, codec_id: int) -> None:
        self.codec_id = codec_id
        self._planes = PlaneReader(codec_id, reads_ranges=True)
        self._reader: PictureReader | None = None
        self._stream: _Stream | None = None
        self._read: tuple[int, int] | None = None

    def decode(self, message: Message) -> list[Frame]:
        """The message's frame.

        Raises DecodeError; MissingReferenceError when a key message, or one with an IDR picture, has to come first.
        """
        check_codec(message, self.codec_id)
        if message.needs is not None and self._read != (message.stream_id, message.needs):
            raise missing_reference(message, message.needs)
        planes = self._planes.read(replace(message, needs=None))  # of pictures alone one needs another
        sensor = planes.sensor
        data = message.section(SectionType.RANGE)
        if planes.valid.any():
            stream, unit = _split(data)
            where = cells(stream.layout, positions(stream.layout, planes.azimuth, planes.fired), sensor, planes.valid)
            samples = self._samples(message, stream, unit).reshape(-1)[where]
            planes.ranges[planes.valid] = _ranges(stream, samples, sensor, planes.valid)
        elif data or message.needs is not None:
            raise SectionError(f"{len(data)} bytes of ranges for no return")
        return [planes.frame(message)]

    def flush(self) -> list[Frame]:
        """Nothing: no frame is held back."""
        return []

    def _samples(self, message: Message, stream: _Stream, unit: bytes) -> npt.NDArray[np.uint16]:
        """The picture of a message. After any error only an IDR picture is taken."""
        reader, idr = self._reader, message.needs is None
        self._read = None
        if idr:
            reader = PictureReader(*stream.layout.shape, stream.bits)
        elif reader is None or stream != self._stream:
            raise SectionError("a picture unlike the one that it refers to")
        samples = reader.read(unit, idr=idr)
        self._reader, self._stream, self._read = reader, stream, (message.stream_id, message.frame_index)
        return samples
