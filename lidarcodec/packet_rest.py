"""PacketRest: everything in the packets of other sensors than the HDL-64E that the planes of a frame do not hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError
from lidarcodec.side import Position, check_positions
from lidarcodec.units import MAX_PACKETS

MAX_ODD_BYTES: Final = 65_507
"""Most bytes of one packet: the largest payload of UDP over IPv4. A message of a point cloud, the only packet of its
frame, may have MAX_ODD_TOTAL."""
MAX_ODD_TOTAL: Final = 32 * 2**20
"""Most bytes of all odd packets of a frame."""
MAX_SERIES: Final = 64
"""Most series of a frame."""


@dataclass(frozen=True, eq=False)
class PacketRest:
    """Rest of the packets of one frame; P packets, of which K are odd: their layout does not fit, or cannot be undone.

    layout:      name of the layout of the others; empty if all are odd
    packet_ns:   (P,) int64, host time of each packet minus the frame's stamp_ns
    odd:         (K,) uint16, ascending: the places of the odd packets
    odd_packets: their bytes
    series:      as `lidarcodec.sensors.images.Images.series`, of the packets that are not odd
    positions:   packets that the sensor sends to another port (GPS position, inertial unit), in order
    """

    layout: str
    packet_ns: npt.NDArray[np.int64]
    odd: npt.NDArray[np.uint16]
    odd_packets: tuple[bytes, ...]
    series: Mapping[str, npt.NDArray[np.unsignedinteger]] = field(default_factory=dict)
    positions: tuple[Position, ...] = ()

    def __post_init__(self) -> None:
        packets, odd = len(self.packet_ns), self.odd
        if packets > MAX_PACKETS or self.packet_ns.dtype != np.int64 or self.packet_ns.ndim != 1:
            raise SectionError(f"a frame of {packets} packets: the limit is {MAX_PACKETS}")
        if odd.dtype != np.uint16 or odd.ndim != 1 or len(odd) != len(self.odd_packets) or len(odd) > packets:
            raise SectionError(f"{len(odd)} places of {len(self.odd_packets)} odd packets in a frame of {packets}")
        if len(odd) and (int(odd[-1]) >= packets or not np.all(odd[1:] > odd[:-1])):
            raise SectionError(f"odd packets at places that are not ascending, or beyond the {packets} of the frame")
        total = sum(map(len, self.odd_packets))
        longest = max(map(len, self.odd_packets), default=0)
        if total > MAX_ODD_TOTAL or (longest > MAX_ODD_BYTES and packets > 1):
            raise SectionError(
                f"odd packets of {total} bytes: the limits are {MAX_ODD_BYTES} each and {MAX_ODD_TOTAL} together"
            )
        if len(self.series) > MAX_SERIES:
            raise SectionError(f"{len(self.series)} series of numbers in a frame: the limit is {MAX_SERIES}")
        self.packet_ns.flags.writeable = odd.flags.writeable = False
        for values in self.series.values():
            values.flags.writeable = False
        if self.positions:
            check_positions(self.positions, packets)

    def with_positions(self, positions: tuple[Position, ...]) -> PacketRest:
        """The same with these position packets."""
        return replace(self, positions=positions)

    @property
    def packets(self) -> int:
        """Number of packets."""
        return len(self.packet_ns)

    @property
    def regular(self) -> npt.NDArray[np.intp]:
        """(P - K,) places of the packets that are not odd."""
        return np.delete(np.arange(self.packets), self.odd.astype(np.intp))
