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

from lidarcodec.codecs.base import CodecSettings, Decoder, Encoder, InForce, Others
from lidarcodec.codecs.frame_decoder import PlaneReader, check_codec, missing_reference
from lidarcodec.codecs.frame_encoder import Coded, FrameEncoder
from lidarcodec.codecs.pictures import Picture, PictureContent, PictureDecoder
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.planes.intensity import Quality
from lidarcodec.planes.sections import encode_planes
from lidarcodec.ranges.image.canvas import level_offsets
from lidarcodec.ranges.image.holes import filled_lines
from lidarcodec.ranges.image.range_cells import Numbers, RangeCells
from lidarcodec.ranges.mapping import CANVAS, NAMES, MappingName, Scale, check_top, mapping_of
from lidarcodec.ranges.video.h264_stream import PictureReader, PictureWriter, Preset
from lidarcodec.ranges.video.turn_canvas import TurnLayout, aligned_cells, cells, positions
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import StreamSettings
from lidarcodec.units import LASERS

Mask = npt.NDArray[np.bool_]

HEAD: Final = struct.Struct("<BBIHBB")
"""bits u8, mapping u8, top u32, columns u16, bands u8, anchored u8."""
TOP_STEP_UM: Final = 4_096_000
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


def _split(data: bytes, rows: int = LASERS, scale: Scale = CANVAS) -> tuple[_Stream, bytes]:
    """Head of a RANGE section, and its access unit. rows: of the sensor; scale: of its ranges

    Raises SectionError.
    """
    if len(data) < HEAD.size:
        raise SectionError(f"a range section of {len(data)} bytes ends before its pictures are known")
    bits, mapping, top, columns, bands, anchored = HEAD.unpack_from(data)
    if bits not in (8, 10) or mapping >= len(NAMES) or anchored > 1:
        raise SectionError(f"pictures of {bits} bits by mapping {mapping}, anchored {anchored}")
    layout = TurnLayout(columns, bands, bool(anchored), rows)
    return _Stream(bits, NAMES[mapping], check_top(top, scale.most), layout), data[HEAD.size :]


def _ranges(
    stream: _Stream, samples: npt.NDArray[np.uint16], sensor: SensorModel, valid: Mask
) -> npt.NDArray[np.uint16]:
    """(N,) uint16, ranges of the returns in row order, none of them 0. samples: (N,)."""
    values = mapping_of(stream.mapping, stream.bits, stream.top).value[samples]
    added = np.repeat(level_offsets(sensor), np.count_nonzero(valid, axis=1))
    near: npt.NDArray[np.uint16] = np.clip(values - added, 1, 65535).astype(np.uint16)
    return near


class Columns(NamedTuple):
    """Where the columns of a frame look. azimuth: (2, W), 0.01 degree; fired: (2, W) bool."""

    azimuth: npt.NDArray[np.uint16]
    fired: Mask

    @classmethod
    def of(cls, cells: RangeCells) -> Columns:
        """Those of a sensor whose columns have one azimuth."""
        return cls(np.stack((cells.azimuth, cells.azimuth)), np.ones((2, len(cells.azimuth)), np.bool_))


class PictureStream:
    """Pictures of the frames of a stream, each predicted from the one before. rows: of the sensor; scale: of ranges"""

    def __init__(self, rows: int = LASERS, scale: Scale = CANVAS) -> None:
        self.rows, self.scale = rows, scale
        self._stream: _Stream | None = None
        self._writer: PictureWriter | None = None
        self._made_for: VideoSettings | None = None
        self._written: int | None = None
        self._farthest = 0

    def end(self) -> None:
        """The next picture refers to none before."""
        self._writer = None

    def write(
        self,
        index: int,
        values: npt.NDArray[np.int32],
        columns: Columns,
        place: Callable[[TurnLayout], npt.NDArray[np.intp]],
        own: VideoSettings,
        *,
        key: bool,
    ) -> Picture:
        """Head and picture of a frame. index: of the frame; values: (N,) ranges of its returns, N > 0

        place: gives for a layout where in the flattened picture each return is, (N,)
        """
        writer, stream = self._writer_for(columns, int(values.max()), own, key=key)
        idr, needs = (key or self._written is None), self._written
        mapped = mapping_of(stream.mapping, stream.bits, stream.top, self.scale.step_um).sample[values]
        where = place(stream.layout)
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
        self._written = index
        return Picture(stream.pack() + unit, None if idr else needs)

    def _writer_for(
        self, columns: Columns, farthest: int, own: VideoSettings, *, key: bool
    ) -> tuple[PictureWriter, _Stream]:
        """The writer that goes on, or a new one if this frame does not fit what it began with."""
        self._farthest = max(farthest, 0 if key else self._farthest)
        writer, stream = self._writer if own == self._made_for else None, self._stream
        if writer is None or stream is None or key or not stream.layout.holds(*columns):
            layout = TurnLayout.fitting(*columns, self.rows)
        else:
            layout = stream.layout
        top_step = max(TOP_STEP_UM // self.scale.step_um, 1)
        top = min(-(-self._farthest // top_step) * top_step, self.scale.most)
        if stream is not None and not key and self._farthest <= stream.top:
            top = stream.top
        fresh = _Stream(own.bits, own.mapping, top, layout)
        if writer is None or fresh != stream:
            writer = PictureWriter(*layout.shape, own.bits, own.crf, own.preset)
            self._writer, self._made_for, self._stream, self._written = writer, own, fresh, None
        return writer, fresh


class VideoContent:
    """What a video codec sends of a frame: planes, and a picture of its ranges."""

    _settings: InForce[VideoSettings]

    def __init__(self) -> None:
        self._pictures = PictureStream()

    def take(self, settings: InForce[VideoSettings]) -> bool:
        """Takes settings. Other settings of the codec begin the pictures anew, without a key message."""
        self._settings = settings
        return False

    def code(self, frame: Frame, *, key: bool) -> Coded:
        """Picture and planes of a frame."""
        planes = encode_planes(frame, Quality.of(self._settings.stream))
        valid = frame.valid
        picture = self._picture(frame, valid, key) if valid.any() else Picture(b"")
        if key and not picture.data:
            self._pictures.end()
        return Coded([Section(SectionType.RANGE, picture.data), *planes], picture.needs)

    def _picture(self, frame: Frame, valid: Mask, key: bool) -> Picture:
        """The RANGE section, and the index of the frame that it refers to."""
        values = (frame.range_u16 + level_offsets(frame.sensor)[:, None])[valid]

        def place(layout: TurnLayout) -> npt.NDArray[np.intp]:
            return cells(layout, positions(layout, frame.azimuth, frame.fired), frame.sensor, valid)

        own = self._settings.own
        return self._pictures.write(frame.index, values, Columns(frame.azimuth, frame.fired), place, own, key=key)


def video_encoder(model: type[VideoSettings]) -> Callable[[int, StreamSettings, int], Encoder]:
    """Makes the encoders of a video codec. model: of its own settings."""
    return lambda codec_id, settings, stream_id: FrameEncoder(codec_id, settings, stream_id, model, VideoContent())


class PicturesRead:
    """Reads the pictures of a stream; holds the picture reader and whose picture it read last."""

    def __init__(self) -> None:
        self._reader: PictureReader | None = None
        self._stream: _Stream | None = None
        self._read: tuple[int, int] | None = None

    def check(self, message: Message) -> None:
        """Raise MissingReferenceError if the picture before the one of a message was not read."""
        if message.needs is not None and self._read != (message.stream_id, message.needs):
            raise missing_reference(message, message.needs)

    def samples(self, message: Message, stream: _Stream, unit: bytes) -> npt.NDArray[np.uint16]:
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


class VideoDecoder:
    """Messages to frames, one each."""

    def __init__(self, codec_id: int) -> None:
        self.codec_id = codec_id
        self._planes = PlaneReader(codec_id, reads_ranges=True)
        self._pictures = PicturesRead()

    def decode(self, message: Message) -> list[Frame]:
        """The message's frame.

        Raises DecodeError; MissingReferenceError when a key message, or one with an IDR picture, has to come first.
        """
        check_codec(message, self.codec_id)
        if message.goes_on:
            raise SectionError("a video of a part of a turn")
        self._pictures.check(message)
        planes = self._planes.read(replace(message, needs=None))  # of pictures alone one needs another
        sensor = planes.sensor
        data = message.section(SectionType.RANGE)
        if planes.valid.any():
            stream, unit = _split(data)
            where = cells(stream.layout, positions(stream.layout, planes.azimuth, planes.fired), sensor, planes.valid)
            samples = self._pictures.samples(message, stream, unit).reshape(-1)[where]
            planes.ranges[planes.valid] = _ranges(stream, samples, sensor, planes.valid)
        elif data or message.needs is not None:
            raise SectionError(f"{len(data)} bytes of ranges for no return")
        return [planes.frame(message)]

    def flush(self) -> list[Frame]:
        """Nothing: no frame is held back."""
        return []


class _OtherPictures:
    """Writes pictures of any sensor."""

    def __init__(self) -> None:
        self._pictures = PictureStream()

    def end(self) -> None:
        self._pictures.end()

    def write(self, index: int, numbers: Numbers, cells: RangeCells, own: VideoSettings, *, key: bool) -> Picture:
        scale, rows = Scale.of(cells.most, cells.step_m), len(cells.shift)
        if (rows, scale) != (self._pictures.rows, self._pictures.scale):
            self._pictures = PictureStream(rows, scale)
        columns = Columns.of(cells)

        def place(layout: TurnLayout) -> npt.NDArray[np.intp]:
            return aligned_cells(layout, positions(layout, *columns)[0], cells.shift, cells.known)

        return self._pictures.write(index, numbers[cells.known].astype(np.int32), columns, place, own, key=key)


class _OtherPicturesRead:
    """Reads pictures of any sensor."""

    def __init__(self) -> None:
        self._pictures = PicturesRead()

    def read(self, message: Message, data: bytes, cells: RangeCells) -> npt.NDArray[np.int32]:
        self._pictures.check(message)
        scale = Scale.of(cells.most, cells.step_m)
        stream, unit = _split(data, len(cells.shift), scale)
        places = positions(stream.layout, *Columns.of(cells))[0]
        where = aligned_cells(stream.layout, places, cells.shift, cells.known)
        samples = self._pictures.samples(message, stream, unit).reshape(-1)[where]
        found = np.zeros(cells.known.shape, np.int32)
        found[cells.known] = mapping_of(stream.mapping, stream.bits, stream.top, scale.step_um).value[samples]
        return found


def video_others(model: type[VideoSettings]) -> Others:
    """Encoder and decoder of frames of other sensors than the HDL-64E. model: of the codec's own settings."""

    def make(codec_id: int, settings: StreamSettings, stream_id: int) -> Encoder:
        content = PictureContent[VideoSettings](_OtherPictures(), exact=False)
        return FrameEncoder(codec_id, settings, stream_id, model, content)

    def open_decoder(codec_id: int) -> Decoder:
        return PictureDecoder(codec_id, _OtherPicturesRead(), exact=False)

    return Others(make, open_decoder)
