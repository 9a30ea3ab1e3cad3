"""Frames of other sensors than the HDL-64E, of a codec that codes ranges as pictures.

The PLANES section holds all other planes, as those of `predictive`, and in place of ranges the small numbers of
range_cells.py. The RANGE section is bits of ranges u8, step varint (1 without a bound), and the picture; it has none if
there is no return.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs.base import CodecSettings, Decoder, Encoder, InForce, Others, Own
from lidarcodec.codecs.frame_decoder import check_codec
from lidarcodec.codecs.frame_encoder import Coded, FrameEncoder
from lidarcodec.codecs.other_decoder import PlaneDecoder
from lidarcodec.codecs.plane_content import frame_sections, sent_azimuth, sent_planes, shift_of
from lidarcodec.entropy.varint import VarintReader, put_varint
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.frame_images import RANGE, layout_of
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.planes.attribute_values import AttributeQuality
from lidarcodec.planes.plane_section import MAX_BITS, MAX_STEP, PlaneKind, encode_plane_section, read_head
from lidarcodec.ranges.image.range_cells import Numbers, RangeCells, check_second, join_ranges, split_ranges
from lidarcodec.sensors.images import PacketLayout, Unsigned
from lidarcodec.settings import StreamSettings, step_of

READ_AS: Final = 11
"""Codec under whose number the native session reads the planes: `predictive`, whose planes they are."""


Own_contra = TypeVar("Own_contra", bound=CodecSettings, contravariant=True)


class Picture(NamedTuple):
    """data: of the RANGE section behind its head; needs: index of the frame whose picture it refers to, or None"""

    data: bytes
    needs: int | None = None


class PictureWriting(Protocol[Own_contra]):
    """Writes the ranges of the frames of a stream as pictures."""

    def write(self, index: int, numbers: Numbers, cells: RangeCells, own: Own_contra, *, key: bool) -> Picture:
        """The picture of a frame. index: of the frame; numbers: (H, W) uint32, 0 where there is no return; there is one

        key: the picture refers to none before
        """

    def end(self) -> None:
        """The next picture refers to none before."""


class PictureReading(Protocol):
    """Reads the ranges of the frames of a stream out of pictures."""

    def read(self, message: Message, data: bytes, cells: RangeCells) -> npt.NDArray[Any]:
        """(H, W) samples of those numbers, anything where there is no return. data: of the RANGE section behind its
        head, of a frame with returns

        Raises SectionError, MissingReferenceError.
        """


class CodedImages(NamedTuple):
    """planes: the PLANES section; numbers and cells: what the picture is made of; step: of the numbers"""

    planes: bytes
    numbers: Numbers
    cells: RangeCells
    step: int


def coded_images(frame: Frame, layout: PacketLayout, stream: StreamSettings, *, exact: bool) -> CodedImages:
    """The planes of a frame beside its picture, coded, and what the picture is made of."""
    step = 1 if stream.max_error_m is None else step_of(stream.max_error_m, frame.sensor.range_step_m)
    sent = sent_planes(frame, layout, AttributeQuality.of(stream))
    split = split_ranges(sent.forms, sent.planes, step, exact=exact)
    shift, reduced = shift_of(frame), frame.keep is not None
    planes = encode_plane_section(PlaneKind.MODELLED, split.forms, split.planes, shift, 1, sent.tables, reduced=reduced)
    bits = next(form.bits for form in sent.forms if form.name == RANGE)
    cells = RangeCells(split.numbers > 0, shift, sent_azimuth(frame), frame.sensor.range_step_m, bits)
    return CodedImages(planes, split.numbers, cells, step)


def head_of(bits: int, step: int) -> bytes:
    """The head of a RANGE section."""
    out = bytearray([bits])
    put_varint(out, step)
    return bytes(out)


def split_head(data: bytes) -> tuple[int, int, bytes]:
    """Bits of ranges, their step, and what follows the head of a RANGE section.

    Raises SectionError or TruncatedError.
    """
    reader = VarintReader(data)
    bits, step = reader.byte(), reader.varint(MAX_STEP, least=1)
    if not 1 <= bits <= MAX_BITS or not step % 2:
        raise SectionError(f"a picture of ranges of {bits} bits with step {step}")
    return bits, step, data[reader.offset :]


class PictureContent(Generic[Own]):
    """What a codec of pictures sends of a frame. exact: whether it keeps a bound, so that pictures hold numbers."""

    _settings: InForce[Own]

    def __init__(self, writing: PictureWriting[Own], *, exact: bool) -> None:
        self._writing, self._exact = writing, exact

    def take(self, settings: InForce[Own]) -> bool:
        """Takes settings; no frame needs a key message for them."""
        self._settings = settings
        return False

    def code(self, frame: Frame, *, key: bool) -> Coded:
        """All sections of a frame but its calibration."""
        found = layout_of(frame)
        if found is None:
            if key:
                self._writing.end()
            return Coded(frame_sections(frame, []), None)
        coded = coded_images(frame, found[1], self._settings.stream, exact=self._exact)
        picture = Picture(b"")
        if coded.cells.known.any():
            picture = self._writing.write(frame.index, coded.numbers, coded.cells, self._settings.own, key=key)
        elif key:
            self._writing.end()
        ranges = head_of(coded.cells.bits, coded.step) + picture.data
        images = [Section(SectionType.PLANES, coded.planes), Section(SectionType.RANGE, ranges)]
        return Coded(frame_sections(frame, images), picture.needs)


class PictureDecoder:
    """Decoder of frames of other sensors than the HDL-64E, of a codec of pictures."""

    def __init__(self, codec_id: int, reading: PictureReading, *, exact: bool) -> None:
        self.codec_id = codec_id
        self._planes = PlaneDecoder(READ_AS)
        self._reading, self._exact = reading, exact

    def decode(self, message: Message) -> list[Frame]:
        """The message's frame.

        Raises DecodeError; MissingReferenceError when a key message has to come first.
        """
        check_codec(message, self.codec_id)
        (frame,) = self._planes.decode(replace(message, codec=READ_AS, needs=None))
        if not message.has(SectionType.PLANES):
            if message.has(SectionType.RANGE) or message.needs is not None:
                raise SectionError("a picture of a frame without planes")
            return [frame]
        bits, step, data = split_head(message.section(SectionType.RANGE))
        if step != 1 and not self._exact:
            raise SectionError(f"a picture that keeps no bound, with a range step of {step}")
        cells = cells_of(frame, message, bits)
        if cells.known.any():
            samples = self._reading.read(message, data, cells)
        elif data or message.needs is not None:
            raise SectionError(f"{len(data)} bytes of ranges for no return")
        else:
            samples = np.zeros(cells.known.shape, np.uint16)
        return [with_ranges(frame, samples, step, bits, exact=self._exact)]

    def flush(self) -> list[Frame]:
        """Nothing: no frame is held back."""
        return []


def cells_of(frame: Frame, message: Message, bits: int) -> RangeCells:
    """What is known of the cells of a frame whose planes beside the picture were decoded; none if it has no planes.

    Raises SectionError.
    """
    shift = np.zeros(frame.sensor.rows, np.int32)
    if message.has(SectionType.PLANES):
        head = read_head(message.section(SectionType.PLANES))
        check_second(head.forms)
        shift = head.shift
    known = _sent(frame, frame.range) > 0
    return RangeCells(known, shift, sent_azimuth(frame), frame.sensor.range_step_m, bits)


def with_ranges(frame: Frame, samples: npt.NDArray[Any], step: int, bits: int, *, exact: bool) -> Frame:
    """The frame with ranges out of a picture. samples: (H, W), of the columns that were sent

    Raises SectionError.
    """
    planes: dict[str, Unsigned] = {RANGE: frame.range, **frame.planes}
    found = join_ranges({name: _sent(frame, image) for name, image in planes.items()}, samples, step, bits, exact=exact)
    whole: dict[str, Unsigned] = {name: _in_own_columns(frame, image) for name, image in found.items()}
    ranges = whole.pop(RANGE)
    return frame.with_(range=ranges, planes=dict(frame.planes) | whole)


def _sent(frame: Frame, image: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The columns of an image that were sent."""
    return image if frame.lattice is None else image[:, frame.lattice]


def _in_own_columns(frame: Frame, image: Unsigned) -> Unsigned:
    if frame.lattice is None:
        return image
    whole = np.zeros((len(image), frame.width), image.dtype)
    whole[:, frame.lattice] = image
    return whole


class _WritingAlone(Generic[Own]):
    """Pictures that refer to none before."""

    def __init__(self, write: Callable[[Numbers, RangeCells, Own], bytes]) -> None:
        self._write = write

    def write(self, index: int, numbers: Numbers, cells: RangeCells, own: Own, *, key: bool) -> Picture:
        return Picture(self._write(numbers, cells, own))

    def end(self) -> None:
        """Nothing: there is none before."""


class _ReadingAlone:
    """The same, read."""

    def __init__(self, read: Callable[[bytes, RangeCells], npt.NDArray[Any]]) -> None:
        self._read = read

    def read(self, message: Message, data: bytes, cells: RangeCells) -> npt.NDArray[Any]:
        if message.needs is not None:
            raise SectionError(f"a picture that needs frame {message.needs}")
        return self._read(data, cells)


def picture_others(
    model: type[Own],
    write: Callable[[Numbers, RangeCells, Own], bytes],
    read: Callable[[bytes, RangeCells], npt.NDArray[Any]],
    *,
    exact: bool,
) -> Others:
    """Encoder and decoder of frames of other sensors, of a codec whose pictures refer to none before.

    model: of the codec's own settings; write, read: a picture of numbers, (H, W); exact: as of `PictureContent`
    """

    def make(codec_id: int, settings: StreamSettings, stream_id: int) -> Encoder:
        return FrameEncoder(
            codec_id, settings, stream_id, model, PictureContent[Own](_WritingAlone(write), exact=exact)
        )

    def open_decoder(codec_id: int) -> Decoder:
        return PictureDecoder(codec_id, _ReadingAlone(read), exact=exact)

    return Others(make, open_decoder)
