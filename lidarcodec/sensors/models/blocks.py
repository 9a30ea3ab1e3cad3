"""Packets made of blocks: those of Velodyne and Hesai, as one layout that is given their fields.

A block holds the returns of one or more firings of the lasers, with one azimuth. The packet is a numpy record:

    blocks   (B,) records of `azimuth` u16 and `units` (U,), and `flag` where the sensor sends one;
             a unit is `distance` u16, `intensity` u8 and perhaps `confidence` u8
    others   head and tail: each a constant, which `fits` demands and `join` writes, or a series

Cells: with one return the units of all blocks are, one after the other, the columns of H channels. With two returns
the blocks 2n and 2n + 1 hold the first and the second return of the same lasers; `range` is the return that is sent
first, `range2` the one after it. Channels are sorted into rows by `channel_of_row`.

Series: `azimuth` of the first block of each group of blocks that share one position, `azimuth_rest` what the others of
the group differ by (modulo 2**16; all zero as long as the sensor keeps to its manual), and the fields of head and tail
by their names, arrays flattened. The series of a checksum is what was sent XOR what the bytes give: zero if it is
right.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError
from lidarcodec.sensors.images import Bytes, Images, Plane, Turn, Unsigned, packets_of_images
from lidarcodec.sensors.models.checksum import crc32_mpeg2
from lidarcodec.units import AZIMUTH_TURN

Allowed = tuple[int, ...]
Records = npt.NDArray[np.void]


@dataclass(frozen=True, eq=False)
class BlockLayout:
    """A PacketLayout of packets made of blocks.

    packet: record of a whole packet, packed; group: blocks that share one position; returns: 1 or 2;
    constants: field (`blocks.flag` for the flags) -> values, one for each element of the field, that every packet has;
    modes: field -> values of which every packet has one, kept as a series;
    checksums: field -> first byte and end of what it is the CRC-32/MPEG-2 of
    """

    name: str
    packet: np.dtype[np.void]
    channel_of_row: tuple[int, ...]
    returns: int
    group: int
    constants: Mapping[str, Allowed]
    modes: Mapping[str, Allowed]
    checksums: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def packet_bytes(self) -> int:
        """Size of each packet's UDP payload."""
        return self.packet.itemsize

    @cached_property
    def turn(self) -> Turn:
        """The azimuth of the first block."""
        fields = self.packet.fields
        blocks = self.packet["blocks"].base
        return Turn(int(fields["blocks"][1]) + int(blocks.fields["azimuth"][1]), AZIMUTH_TURN)  # type: ignore[index]

    @cached_property
    def marks(self) -> tuple[tuple[int, int], ...]:
        """Bytes that every packet has, as (offset, value): those of head and tail first."""
        written = []
        for filling in (0x00, 0xFF):
            packet = np.full(self.packet_bytes, filling, np.uint8)
            record = packet.view(self.packet)
            for name, constant in self.constants.items():
                fields = _field(record, name)
                fields[...] = np.array(constant).reshape(fields.shape[1:])
            written.append(packet)
        begin = int(self.packet.fields["blocks"][1])  # type: ignore[index]
        end = begin + self.packet["blocks"].itemsize
        offsets = np.flatnonzero(written[0] == written[1]).tolist()
        offsets.sort(key=lambda offset: (begin <= offset < end, offset))
        return tuple((offset, int(written[0][offset])) for offset in offsets)

    @property
    def rows(self) -> int:
        """H."""
        return len(self.channel_of_row)

    @property
    def columns(self) -> int:
        """Columns of one packet."""
        return self.blocks * self._units // (self.rows * self.returns)

    @property
    def blocks(self) -> int:
        """Blocks of one packet."""
        return int(self.packet["blocks"].shape[0])

    @cached_property
    def planes(self) -> tuple[Plane, ...]:
        """`range`, `intensity` and perhaps `confidence`; the same with a 2 at the end for the second return."""
        planes: list[Plane] = []
        for end in ("", "2")[: self.returns]:
            planes.append(Plane(f"range{end}", 16, "second range" if end else "range"))
            attributes = self._unit_fields[1:]
            planes += [Plane(f"{name}{end}", 8, "attribute", f"range{end}") for name in attributes]
        return tuple(planes)

    @cached_property
    def series(self) -> dict[str, tuple[np.dtype[np.unsignedinteger], int]]:
        """Name of each series -> its dtype, and its numbers in one packet."""
        groups = self.blocks // self.group
        series = {"azimuth": (np.dtype(np.uint16), groups)}
        if self.group > 1:
            series["azimuth_rest"] = (np.dtype(np.uint16), self.blocks - groups)
        for name in self.packet.names or ():
            if name != "blocks" and name not in self.constants:
                kind = self.packet[name]
                series[name] = (kind.base.newbyteorder("="), int(np.prod(kind.shape, dtype=int)))
        return series

    def takes(self, payload: bytes) -> bool:
        """Whether this layout fits a payload: as `fits`, for one of any length, in about 2 us."""
        return (
            len(payload) == self.packet_bytes
            and all(payload[at] in allowed for at, allowed in self._mode_bytes)
            and all(payload[start:end] == fixed for start, end, fixed in self._fixed_bytes)
        )

    def fits(self, packets: Bytes) -> npt.NDArray[np.bool_]:
        """(P,) bool, which packets have this layout's constants and one of its modes. packets: (P, packet_bytes)."""
        records = self._records(packets)
        fits = np.ones(len(records), np.bool_)
        for name, values in self.constants.items():
            fits &= (_field(records, name).reshape(len(records), len(values)) == values).all(axis=1)
        for name, values in self.modes.items():
            fits &= np.isin(records[name], values)
        return fits

    def split(self, packets: Bytes) -> Images:
        """Images of packets that fit; W is P times `columns`. packets: (P, packet_bytes)."""
        records = self._records(packets)
        blocks = records["blocks"]
        planes: dict[str, Unsigned] = {}
        for plane in self.planes:
            end = int(plane.name.endswith("2"))
            units = blocks["units"][_unit_field(plane.name)][:, end :: self.returns]
            cells = units.reshape(-1, self.rows)[:, list(self.channel_of_row)]
            planes[plane.name] = np.ascontiguousarray(cells.T).astype(plane.dtype, copy=False)
        azimuth = blocks["azimuth"].reshape(-1, self.group)
        series: dict[str, Unsigned] = {"azimuth": azimuth[:, 0].astype(np.uint16)}
        if self.group > 1:
            series["azimuth_rest"] = (azimuth[:, 1:] - azimuth[:, :1]).ravel().astype(np.uint16)
        for name, (dtype, _) in self.series.items():
            if name not in series:
                series[name] = records[name].ravel().astype(dtype)
        for name, (start, end) in self.checksums.items():
            series[name] = series[name] ^ crc32_mpeg2(packets[:, start:end])
        return Images(planes, series)

    def join(self, images: Images) -> Bytes:
        """(P, packet_bytes): packets of images, the inverse of `split`.

        Raises SectionError if the shapes or the lengths of series do not fit together, or a value does not fit its
        field.
        """
        count = packets_of_images(self, images)
        records = np.zeros(count, self.packet)
        self._write_constants(records)
        blocks = records["blocks"]
        channel_of_row = np.array(self.channel_of_row)
        for plane in self.planes:
            end = int(plane.name.endswith("2"))
            units = blocks["units"][_unit_field(plane.name)]
            cells = np.empty((count * self.columns, self.rows), np.uint16)
            cells[:, channel_of_row] = _within(images.planes[plane.name], (1 << plane.bits) - 1, plane.name).T
            units[:, end :: self.returns] = cells.reshape(count, self.blocks // self.returns, self._units)
        numbers = {name: self._numbers(images, name, count) for name in self.series}
        azimuth = np.empty((count * self.blocks // self.group, self.group), np.uint16)
        azimuth[:, 0] = numbers.pop("azimuth")
        if self.group > 1:
            azimuth[:, 1:] = azimuth[:, :1] + numbers.pop("azimuth_rest").reshape(-1, self.group - 1)
        blocks["azimuth"] = azimuth.reshape(count, self.blocks)
        for name, values in numbers.items():
            records[name] = values.reshape(records[name].shape)
        for name, allowed in self.modes.items():
            if not np.isin(records[name], allowed).all():
                raise SectionError(f"series {name} holds a value that packets of the layout {self.name} never have")
        packets = records.view(np.uint8).reshape(count, self.packet_bytes)
        for name, (start, end) in self.checksums.items():
            records[name] ^= crc32_mpeg2(packets[:, start:end])
        return packets

    @property
    def _units(self) -> int:
        return int(self.packet["blocks"].base["units"].shape[0])

    @property
    def _unit_fields(self) -> tuple[str, ...]:
        return ("range", *(self.packet["blocks"].base["units"].base.names or ())[1:])

    @cached_property
    def _mode_bytes(self) -> tuple[tuple[int, Allowed], ...]:
        """Place in the packet, and the allowed values, of each mode."""
        fields: Any = self.packet.fields
        return tuple((fields[name][1], allowed) for name, allowed in self.modes.items())

    @cached_property
    def _fixed_bytes(self) -> tuple[tuple[int, int, bytes], ...]:
        """First byte, end and value of each run of bytes that are the same in every packet."""
        low, high = np.zeros(1, self.packet), np.zeros(1, self.packet)
        high.view(np.uint8)[:] = 0xFF
        for records in (low, high):
            self._write_constants(records)
        same = np.concatenate([[False], low.view(np.uint8) == high.view(np.uint8), [False]])
        edges = np.flatnonzero(same[1:] != same[:-1]).reshape(-1, 2).tolist()
        return tuple((start, end, low.tobytes()[start:end]) for start, end in edges)

    def _write_constants(self, records: Records) -> None:
        for name, constant in self.constants.items():
            fields = _field(records, name)
            fields[...] = np.array(constant).reshape(fields.shape[1:])

    def _records(self, packets: Bytes) -> Records:
        return np.ascontiguousarray(packets, np.uint8).view(self.packet)[:, 0]

    def _numbers(self, images: Images, name: str, packets: int) -> Unsigned:
        dtype, each = self.series[name]
        numbers = images.series[name]
        if numbers.shape != (packets * each,):
            raise SectionError(f"series {name} is {numbers.shape}, but {packets} packets have {packets * each} values")
        return _within(numbers, int(np.iinfo(dtype).max), name).astype(dtype)


def reserved(count: int) -> tuple[type[np.uint8], int]:
    """Type of a field of so many bytes without a name."""
    return np.uint8, count


def _unit_field(plane: str) -> str:
    name = plane.removesuffix("2")
    return "distance" if name == "range" else name


def _field(records: Records, name: str) -> Unsigned:
    """A view of a field of all records; a dot leads into the fields of its elements."""
    part: Any = records
    for step in name.split("."):
        part = part[step]
    found: Unsigned = part
    return found


def _within(values: Unsigned, most: int, name: str) -> Unsigned:
    if values.dtype.kind != "u":
        raise SectionError(f"{name} holds {values.dtype} instead of unsigned integers")
    if values.size and int(values.max()) > most:
        raise SectionError(f"{name} holds {int(values.max())}: its field ends at {most}")
    return values
