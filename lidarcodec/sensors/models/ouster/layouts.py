"""Packets of Ouster's sensors as images: profiles, headers, columns and pixels.

    LEGACY          C columns of (head 16, H pixels, status u32)
    other profiles  head 32, C columns of (head 12, H pixels), reserved 24, CRC u64

All little endian; C is 16 as a rule. A pixel is one to four words of 32 bits. Pixels of a column are sent from the top
beam down; beams of one column look in different directions, so an image is staggered: `destaggered` in sensor.py.

Planes hold the bits as sent. With the profiles RNG15 a range is in steps of 8 mm, else of 1 mm, and near infrared is in
steps of 16, else of 1. `flags` are all bits between the range and the next field, lowest first. Some of them have no
name, but are set. Bits of a pixel that no firmware sets have to be 0 (`fits`).

Series: fields of the packet's head (one number a packet), of columns (one a column), and `reserved`: the bytes of head
and tail that have no name, in the order sent.

Sources: Ouster's sensor documentation, "Lidar data packet format"; names and places of fields as in ouster-sdk 1.0.1
(BSD-3-Clause).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError
from lidarcodec.sensors.images import Bytes, Images, Plane, Turn, Unsigned, packets_of_images
from lidarcodec.sensors.models.ouster.fields import (
    COLUMN,
    COLUMN_LEGACY,
    CRC,
    FUSA,
    HEAD,
    HEAD_FUSA,
    LEGACY,
    PIXEL_WORDS,
    PIXELS,
    Field,
)

Words = npt.NDArray[np.uint32]
WORD: Final = np.dtype("<u4")
ROWS: Final = (16, 32, 64, 128)
COLUMNS_PER_PACKET: Final = 16
MAX_COLUMNS_PER_PACKET: Final = 64
MAX_PACKET_BYTES: Final = 65_507
"""Of a UDP payload."""

HEAD_BYTES = TAIL_BYTES = 32
ALL_BITS: Final = 0xFFFF_FFFF


@dataclass(frozen=True)
class OusterLayout:
    """A PacketLayout of an Ouster.

    profile: one of PIXELS; rows: H; columns: of one packet; fusa_head: whether the head is that of functional safety;
    turn_columns: columns of a whole turn, 0 if they are not known
    """

    profile: str
    rows: int
    columns: int = COLUMNS_PER_PACKET
    fusa_head: bool = False
    turn_columns: int = 0

    @property
    def name(self) -> str:
        """The profile in small letters; `_head` and the kind of head if it is not the profile's usual one."""
        usual = self.fusa_head == (self.profile == FUSA)
        return self.profile.lower() + ("" if usual else "_head_fusa" if self.fusa_head else "_head_standard")

    @property
    def packet_bytes(self) -> int:
        """Size of each packet's UDP payload."""
        return self.head_bytes + self.columns * self.column_bytes + self.tail_bytes

    @property
    def marks(self) -> tuple[tuple[int, int], ...]:
        """The packet type, 1; packets of the profile LEGACY have none."""
        return () if self.legacy else ((0, 1), (1, 0))

    @property
    def turn(self) -> Turn:
        """The frame id, of which 16 bits are enough."""
        fields = COLUMN_LEGACY if self.legacy else HEAD_FUSA if self.fusa_head else HEAD
        return Turn(next(field.offset for field in fields if field.name == "frame_id"), 1 << 16, counts=True)

    def start_of(self, payload: bytes) -> int | None:
        """Number of the sensor's last start (`init_id`), also counted when settings change; None with LEGACY."""
        if self.legacy:
            return None
        offset = next(field.offset for field in (HEAD_FUSA if self.fusa_head else HEAD) if field.name == "init_id")
        return int.from_bytes(payload[offset : offset + 3], "little")

    @cached_property
    def planes(self) -> tuple[Plane, ...]:
        """`range`, `flags`, `intensity` and what else the profile sends; with a 2 at the end for the second return."""
        planes: list[Plane] = []
        for field in PIXELS[self.profile]:
            of = "range2" if field.name.endswith("2") else "range"
            if field.name == of:
                planes.append(Plane(field.name, field.bits, "second range" if of == "range2" else "range"))
            else:
                planes.append(Plane(field.name, field.bits, "attribute", of))
        return tuple(planes)

    @cached_property
    def series(self) -> dict[str, tuple[np.dtype[np.unsignedinteger], int]]:
        """Name of each series -> its dtype, and its numbers in one packet."""
        series = {field.name: (field.dtype.newbyteorder("="), self.columns) for field in self._column_fields}
        series |= {field.name: (field.dtype.newbyteorder("="), 1) for field in self._packet_fields}
        if self.profile != LEGACY:
            series["reserved"] = (np.dtype(np.uint8), len(self._reserved))
        return series

    @property
    def range_step_m(self) -> float:
        """Metres of one range unit."""
        return 0.008 if "RNG15" in self.profile else 0.001

    @property
    def legacy(self) -> bool:
        """Whether packets have neither head nor tail, and columns end with their status."""
        return self.profile == LEGACY

    @property
    def head_bytes(self) -> int:
        """Bytes before the first column."""
        return 0 if self.legacy else HEAD_BYTES

    @property
    def tail_bytes(self) -> int:
        """Bytes after the last column."""
        return 0 if self.legacy else TAIL_BYTES

    @property
    def column_bytes(self) -> int:
        """Size of a column."""
        return (20 if self.legacy else 12) + self.rows * 4 * PIXEL_WORDS[self.profile]

    def fits(self, packets: Bytes) -> npt.NDArray[np.bool_]:
        """(P,) bool, which packets have 0 in all bits of pixels that no firmware sets. packets: (P, packet_bytes)."""
        words = self._words(np.ascontiguousarray(packets, np.uint8))
        fits = np.ones(len(packets), np.bool_)
        for word, used in enumerate(self._used):
            if used != ALL_BITS:
                set_somewhere = np.bitwise_or.reduce(words[..., word], axis=(1, 2))
                fits &= set_somewhere & np.uint32(ALL_BITS ^ used) == 0
        return fits

    def split(self, packets: Bytes) -> Images:
        """Images of packets that fit; W is P times `columns`. packets: (P, packet_bytes).

        Cost: 1.5 ms for a turn of 128 x 1024 with RNG15_RFL8_NIR8.
        """
        packets = np.ascontiguousarray(packets, np.uint8)
        words = self._words(packets)
        planes: dict[str, Unsigned] = {}
        for word in range(words.shape[-1]):
            cells = np.ascontiguousarray(words[..., word].transpose(2, 0, 1)).reshape(self.rows, -1)
            for plane, field in zip(self.planes, PIXELS[self.profile], strict=True):
                if field.word == word:
                    shifted = cells >> np.uint32(field.shift) if field.shift else cells
                    whole = field.bits in (8, 16) or field.shift + field.bits == 32
                    values = shifted if whole else shifted & np.uint32((1 << field.bits) - 1)
                    planes[field.name] = values.astype(plane.dtype)
        return Images({plane.name: planes[plane.name] for plane in self.planes}, self.numbers(packets))

    def numbers(self, packets: Bytes) -> dict[str, Unsigned]:
        """The series of packets."""
        columns = self._columns(packets)
        series = {field.name: _read(columns, field) for field in self._column_fields}
        series |= {field.name: _read(packets, field) for field in self._packet_fields}
        if not self.legacy:
            series["reserved"] = packets[:, self._reserved].ravel()
        return series

    def join(self, images: Images) -> Bytes:
        """(P, packet_bytes): packets of images, the inverse of `split`.

        Raises SectionError if the shapes or the lengths of series do not fit together, or a value does not fit its
        field. Cost: as `split`.
        """
        count = packets_of_images(self, images)
        packets = np.zeros((count, self.packet_bytes), np.uint8)
        words = self._words(packets)
        for word in range(words.shape[-1]):
            cells = np.zeros((self.rows, count * self.columns), WORD)
            for field in PIXELS[self.profile]:
                if field.word == word:
                    values = _within(images.planes[field.name], field.bits, f"plane {field.name}")
                    cells |= values.astype(np.uint32) << np.uint32(field.shift)
            words[..., word] = cells.reshape(self.rows, count, self.columns).transpose(1, 2, 0)
        columns = self._columns(packets)
        for number in self._column_fields:
            _write(columns, number, self._numbers(images, number.name, count))
        for number in self._packet_fields:
            _write(packets, number, self._numbers(images, number.name, count))
        if not self.legacy:
            reserved = self._numbers(images, "reserved", count)
            packets[:, self._reserved] = _within(reserved, 8, "series reserved").reshape(count, len(self._reserved))
        return packets

    @cached_property
    def _column_fields(self) -> tuple[Field, ...]:
        if self.legacy:
            return (*COLUMN_LEGACY, Field("status", self.column_bytes - 4, 4))
        return COLUMN

    @cached_property
    def _packet_fields(self) -> tuple[Field, ...]:
        if self.legacy:
            return ()
        crc = Field(CRC.name, self.packet_bytes - TAIL_BYTES + CRC.offset, CRC.size)
        return (*(HEAD_FUSA if self.fusa_head else HEAD), crc)

    @cached_property
    def _reserved(self) -> npt.NDArray[np.intp]:
        """Places in a packet of the bytes of head and tail that have no name."""
        free = np.ones(self.packet_bytes, np.bool_)
        free[self.head_bytes : self.packet_bytes - self.tail_bytes] = False
        for field in self._packet_fields:
            free[field.offset : field.offset + field.size] = False
        return np.flatnonzero(free)

    @cached_property
    def _used(self) -> tuple[int, ...]:
        """Bits that have a name, of each word of a pixel."""
        used = [0] * PIXEL_WORDS[self.profile]
        for field in PIXELS[self.profile]:
            used[field.word] |= field.mask
        return tuple(used)

    def _columns(self, packets: Bytes) -> Bytes:
        """(P, columns, column_bytes), a view of the packets."""
        inner = packets[:, self.head_bytes : self.packet_bytes - self.tail_bytes]
        return inner.reshape(len(packets), self.columns, self.column_bytes)

    def _words(self, packets: Bytes) -> Words:
        """(P, columns, H, words of a pixel), a view of the packets."""
        start, words = 16 if self.legacy else 12, PIXEL_WORDS[self.profile]
        pixels = self._columns(packets)[:, :, start : start + 4 * words * self.rows]
        return pixels.view(WORD).reshape(len(packets), self.columns, self.rows, words)

    def _numbers(self, images: Images, name: str, packets: int) -> Unsigned:
        _, each = self.series[name]
        numbers = images.series[name]
        if numbers.shape != (packets * each,):
            raise SectionError(f"series {name} is {numbers.shape}, but {packets} packets have {packets * each} values")
        return numbers


def _read(records: Bytes, field: Field) -> Unsigned:
    """(N,) the number in each record; records: (..., bytes)."""
    given = records[..., field.offset : field.offset + field.size]
    padded = np.zeros((*given.shape[:-1], field.dtype.itemsize), np.uint8)
    padded[..., : field.size] = given
    return padded.view(field.dtype).ravel().astype(field.dtype.newbyteorder("="), copy=False)


def _write(records: Bytes, field: Field, numbers: Unsigned) -> None:
    """The inverse of `_read`."""
    given = (
        _within(numbers, 8 * field.size, f"series {field.name}")
        .astype(field.dtype)
        .view(np.uint8)
        .reshape(*records.shape[:-1], field.dtype.itemsize)
    )
    records[..., field.offset : field.offset + field.size] = given[..., : field.size]


def _within(values: Unsigned, bits: int, name: str) -> Unsigned:
    if values.dtype.kind != "u":
        raise SectionError(f"{name} holds {values.dtype} instead of unsigned integers")
    if 8 * values.dtype.itemsize > bits and values.size and int(values.max()) >> bits:
        raise SectionError(f"{name} holds {int(values.max())}: its field has {bits} bits")
    return values
