"""PcapWriter: packets into a classic pcap file, as the frames that the sensor puts on the wire.

Ethernet, IPv4 and UDP headers have the sensor's factory settings (192.168.3.43:443 to 192.168.3.255:2368,
broadcast, position packets to 8308); the IP check sum is right, the UDP check sum is 0 (none), as the sensor sends it.
With a nanosecond file, which is the default, stamps come back exactly; a microsecond file is for programs that read no
other.

>>> import io
>>> from lidarcodec.packet import Packet
>>> file = io.BytesIO()
>>> PcapWriter(file).write(Packet(bytes(1206), 1_700_000_000_000_000_123))
>>> len(file.getvalue()) == 24 + 16 + 42 + 1206
True
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from functools import lru_cache
from typing import BinaryIO, Final

from lidarcodec.errors import SourceError
from lidarcodec.packet import Packet
from lidarcodec.units import DATA_PORT, POSITION_PORT

SENSOR_ADDRESS: Final = bytes((192, 168, 3, 43))
BROADCAST_ADDRESS: Final = bytes((192, 168, 3, 255))
SENSOR_PORT: Final = 443
_ETHERNET: Final = b"\xff" * 6 + bytes.fromhex("6076881000010800")
MAX_PAYLOAD: Final = 65_507
"""Largest payload of an IPv4 datagram."""
MAX_SECONDS: Final = 1 << 32


def checksum(header: bytes) -> int:
    """The Internet check sum of an even number of bytes (RFC 1071)."""
    total: int = sum(struct.unpack(f">{len(header) // 2}H", header))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF


@lru_cache(maxsize=8)
def headers(size: int, *, position: bool = False) -> bytes:
    """The 42 bytes before a payload of `size` bytes: Ethernet, IPv4, UDP. position: of a position packet."""
    ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 28 + size, 0, 0x4000, 128, 17, 0, SENSOR_ADDRESS, BROADCAST_ADDRESS)
    ip = ip[:10] + struct.pack(">H", checksum(ip)) + ip[12:]
    port = POSITION_PORT if position else SENSOR_PORT  # a sensor sends position packets from that port, too
    return _ETHERNET + ip + struct.pack(">HHHH", port, port if position else DATA_PORT, 8 + size, 0)


class PcapWriter:
    """Writes packets to a binary file. The caller opens and closes the file."""

    def __init__(self, file: BinaryIO, *, nanoseconds: bool = True) -> None:
        self._file = file
        self._step_ns = 1 if nanoseconds else 1000
        magic = 0xA1B23C4D if nanoseconds else 0xA1B2C3D4
        file.write(struct.pack("<IHHiIII", magic, 2, 4, 0, 0, 65_535, 1))

    def write(self, packet: Packet) -> None:
        """Append one packet.

        Raises SourceError for a payload that fits in no datagram, or a time that a pcap file cannot hold.
        """
        size = len(packet.payload)
        seconds, fraction_ns = divmod(packet.stamp_ns, 1_000_000_000)
        if size > MAX_PAYLOAD:
            raise SourceError(f"a payload of {size} bytes does not fit into a UDP datagram (limit {MAX_PAYLOAD})")
        if not 0 <= seconds < MAX_SECONDS:
            raise SourceError(f"a pcap file cannot hold the time {packet.stamp_ns} ns (1970 to 2106 only)")
        record = struct.pack("<IIII", seconds, fraction_ns // self._step_ns, 42 + size, 42 + size)
        self._file.write(record + headers(size, position=packet.position) + packet.payload)

    def write_all(self, packets: Iterable[Packet]) -> int:
        """Append packets. Returns their number.

        Raises the errors of `write`.
        """
        count = 0
        for packet in packets:
            self.write(packet)
            count += 1
        return count
