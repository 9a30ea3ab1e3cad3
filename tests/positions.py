"""Position packets made for tests, as a Velodyne sends them: 512 bytes, a sentence of NMEA that changes once a second.

Layout: "Position packet structure" in the VLP-16 user manual, and the same of the HDL-32E before it: 198 unused bytes
(the HDL-32E: gyroscopes, temperatures and accelerometers from byte 14 on), microseconds since the top of the hour u32,
a byte for the pulse a second, three unused, `$GPRMC` up to CR LF, zeros to the end.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from functools import reduce

from lidarcodec.packet import Packet
from lidarcodec.side import Position

HOUR_US = 3_600_000_000


def sentence(second: int) -> bytes:
    """`$GPRMC` of a car near Karlsruhe, so many seconds after 13:04:32, with its checksum."""
    clock = 13 * 3600 + 4 * 60 + 32 + second
    time = f"{clock // 3600 % 24:02d}{clock // 60 % 60:02d}{clock % 60:02d}"
    text = f"GPRMC,{time},A,4900.{9000 + second:04d},N,00826.{1200 + 3 * second:04d},E,012.3,084.4,260911,002.1,E,D"
    return f"${text}*{reduce(lambda a, b: a ^ b, text.encode()):02X}\r\n".encode()


def payload(stamp_ns: int) -> bytes:
    """The 512 bytes of a position packet of that time."""
    micros = stamp_ns // 1000 % HOUR_US
    shaken = b"".join(struct.pack("<H", 0x0F00 | (micros >> k) % 251) for k in range(12))
    head = bytes(14) + shaken + bytes(160)
    body = head + struct.pack("<IB3x", micros, 2) + sentence(stamp_ns // 10**9 % 1000)
    return body + bytes(512 - len(body))


def position(stamp_ns: int) -> Packet:
    """A position packet."""
    return Packet(payload(stamp_ns), stamp_ns, position=True)


def interleaved(packets: Iterable[Packet], every: int = 14, first: int = 3) -> Iterator[Packet]:
    """Data packets with a position packet before number `first`, and then one for `every` of them."""
    for number, packet in enumerate(packets):
        if number % every == first:
            yield position(packet.stamp_ns - 1000)
        yield packet


def of_frame(packets: int, every: int = 5) -> tuple[Position, ...]:
    """Position packets of a frame: before the first data packet, between, two at one place, and behind the last."""
    places = sorted([*range(0, packets + 1, every), packets // 2, packets])
    stamps = [1_700_000_000_000_000_000 + 288_000 * place + number for number, place in enumerate(places)]
    found = [
        Position(at, 288_000 * at + 1000 * k, payload(ns))
        for k, (at, ns) in enumerate(zip(places, stamps, strict=True))
    ]
    return (*found, Position(packets, 10**9, b""), Position(packets, -(10**9), bytes(range(256)) * 5))
