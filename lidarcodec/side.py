"""SideInfo: everything in packets that the images of a frame do not hold.

A packet is twelve blocks. The *role* of a block says where its data is:

    0 IRREGULAR     kept whole in `irregular` (unknown flag, azimuth beyond 35999)
    1 UPPER_OPENS   lasers 0-31, opened a new column        2 UPPER_JOINS   lasers 0-31, joined the current column
    3 LOWER_OPENS   lasers 32-63, opened a new column       4 LOWER_JOINS   lasers 32-63, joined the current column
    5 UPPER_SECOND  second return of the current column     6 LOWER_SECOND  likewise, lower half

The current column is the last one opened in the same packet. A column never spans two packets, so that a lost packet
cannot join blocks of different firings. `layouts` holds the distinct sequences of twelve roles; `layout` is the index
of each packet's sequence.

>>> side = SideInfo.regular(packets=348)
>>> side.columns
2088
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError
from lidarcodec.units import (
    BLOCK_BYTES,
    BLOCKS_PER_PACKET,
    LASERS_PER_BLOCK,
    MAX_PACKETS,
    MAX_POSITION_BYTES,
    MAX_POSITIONS,
    MAX_POSITIONS_BYTES,
)


class Role(IntEnum):
    """Where the data of a block is."""

    IRREGULAR = 0
    UPPER_OPENS = 1
    UPPER_JOINS = 2
    LOWER_OPENS = 3
    LOWER_JOINS = 4
    UPPER_SECOND = 5
    LOWER_SECOND = 6


REGULAR_LAYOUT = np.array([Role.UPPER_OPENS, Role.LOWER_JOINS] * 6, np.uint8)
"""An S2 in single-return mode: upper and lower block of six firings."""


class Position(NamedTuple):
    """A position packet of a frame.

    place: number of data packets of the frame before it; offset_ns: its host time minus the frame's stamp_ns
    """

    place: int
    offset_ns: int
    payload: bytes


def check_positions(positions: tuple[Position, ...], packets: int) -> None:
    """Check number, sizes and order of position packets.

    Raises SectionError if there are too many, one is too large, or their places are not ascending.
    """
    if len(positions) > MAX_POSITIONS:
        raise SectionError(f"{len(positions)} position packets in a frame: the limit is {MAX_POSITIONS}")
    place = total = 0
    for one in positions:
        if not place <= one.place <= packets:
            raise SectionError(f"a position packet at place {one.place} after {place}, in a frame of {packets} packets")
        if len(one.payload) > MAX_POSITION_BYTES:
            raise SectionError(f"a position packet of {len(one.payload)} bytes: the limit is {MAX_POSITION_BYTES}")
        place, total = one.place, total + len(one.payload)
    if total > MAX_POSITIONS_BYTES:
        raise SectionError(f"position packets of {total} bytes in a frame: the limit is {MAX_POSITIONS_BYTES}")


def _frozen(array: npt.NDArray[np.generic], dtype: npt.DTypeLike, shape: tuple[int | None, ...], name: str) -> None:
    ok = array.dtype == dtype and array.ndim == len(shape)
    if not ok or any(want is not None and have != want for have, want in zip(array.shape, shape, strict=True)):
        raise SectionError(f"side information: {name} is {array.dtype}{array.shape}, not {np.dtype(dtype)}{shape}")
    array.flags.writeable = False


@dataclass(frozen=True, eq=False)
class SideInfo:
    """Side information of the packets of one frame; P packets, L layouts. Arrays are read-only.

    packet_ns: (P,) int64, host time of each packet minus the frame's stamp_ns
    gps_us:    (P,) uint32, the packet's own time stamp as sent
    status:    (P, 2) uint8, status type and value as sent
    layouts:   (L, 12) uint8, distinct sequences of `Role`;  layout: (P,) uint16, index into it
    irregular: (K, 100) uint8, irregular blocks in packet order
    second:    (S, 96) uint8, distances and intensities of second-return blocks in packet order
    positions: position packets in order; messages carry them in a POSITION section, not in SIDE
    """

    packet_ns: npt.NDArray[np.int64]
    gps_us: npt.NDArray[np.uint32]
    status: npt.NDArray[np.uint8]
    layouts: npt.NDArray[np.uint8]
    layout: npt.NDArray[np.uint16]
    irregular: npt.NDArray[np.uint8]
    second: npt.NDArray[np.uint8]
    positions: tuple[Position, ...] = ()

    def __post_init__(self) -> None:
        packets = len(self.packet_ns)
        if packets > MAX_PACKETS:
            raise SectionError(f"side information of {packets} packets: the limit is {MAX_PACKETS}")
        _frozen(self.packet_ns, np.int64, (None,), "packet_ns")
        _frozen(self.gps_us, np.uint32, (packets,), "gps_us")
        _frozen(self.status, np.uint8, (packets, 2), "status")
        _frozen(self.layouts, np.uint8, (None, BLOCKS_PER_PACKET), "layouts")
        _frozen(self.layout, np.uint16, (packets,), "layout")
        _frozen(self.irregular, np.uint8, (None, BLOCK_BYTES), "irregular")
        _frozen(self.second, np.uint8, (None, LASERS_PER_BLOCK * 3), "second")
        if packets and int(self.layout.max()) >= len(self.layouts):
            raise SectionError("side information names a packet layout that it does not hold")
        if self.positions:
            check_positions(self.positions, packets)

    @property
    def packets(self) -> int:
        """Number of packets."""
        return len(self.packet_ns)

    @cached_property
    def columns_per_packet(self) -> npt.NDArray[np.int64]:
        """(P,) int64, columns that each packet opened."""
        opens = (self.layouts == Role.UPPER_OPENS) | (self.layouts == Role.LOWER_OPENS)
        counts: npt.NDArray[np.int64] = opens.sum(axis=1, dtype=np.int64)[self.layout]
        return counts

    @property
    def columns(self) -> int:
        """Number of columns of the frame: its W."""
        return int(self.columns_per_packet.sum())

    @cached_property
    def column_ns(self) -> npt.NDArray[np.int64]:
        """(W,) int64, host time of the packet of each column minus the frame's stamp_ns."""
        stamps: npt.NDArray[np.int64] = np.repeat(self.packet_ns, self.columns_per_packet)
        return stamps

    @classmethod
    def regular(cls, packets: int, interval_ns: int = 288_000) -> SideInfo:
        """Side information of `packets` evenly spaced packets of six whole firings, without GPS time or status."""
        return cls(
            packet_ns=np.arange(packets, dtype=np.int64) * interval_ns,
            gps_us=np.zeros(packets, np.uint32),
            status=np.zeros((packets, 2), np.uint8),
            layouts=REGULAR_LAYOUT[None].copy(),
            layout=np.zeros(packets, np.uint16),
            irregular=np.zeros((0, BLOCK_BYTES), np.uint8),
            second=np.zeros((0, LASERS_PER_BLOCK * 3), np.uint8),
        )
