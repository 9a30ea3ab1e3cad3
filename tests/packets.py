"""Packets made for tests: plain S2 firings, S3 block order, dual return, and nonsense."""

from __future__ import annotations

import lzma
import struct
from pathlib import Path

import numpy as np

from lidarcodec.packet import Packet
from lidarcodec.sensor_model import Calibration, SensorModel
from lidarcodec.sources import open_source

UPPER, LOWER = 0xEEFF, 0xDDFF
RETURN = np.dtype([("distance", "<u2"), ("intensity", "u1")])
BLOCK = np.dtype([("flag", "<u2"), ("azimuth", "<u2"), ("returns", RETURN, 32)])


def packets_in(path: Path | str) -> list[Packet]:
    """The packets of a source."""
    with open_source(path) as source:
        return list(source.packets())


def payloads_in(path: Path | str) -> list[bytes]:
    """The payloads of a source's packets."""
    return [packet.payload for packet in packets_in(path)]


def sensor() -> SensorModel:
    """An HDL-64E whose rings are its lasers in order."""
    return SensorModel("HDL-64E", Calibration.from_values({"vert_correction_rad": np.linspace(0.03, -0.43, 64)}))


def payload(
    blocks: list[tuple[int, int]], rng: np.random.Generator, gps_us: int = 0, status: bytes = b"H\x00"
) -> bytes:
    """A payload of twelve (flag, azimuth) blocks with random returns, a fifth of them empty."""
    found = np.zeros(len(blocks), BLOCK)
    found["flag"], found["azimuth"] = np.array(blocks).T
    returns, size = found["returns"], (len(blocks), 32)
    returns["distance"] = rng.integers(1, 65536, size) * (rng.random(size) > 0.2)
    returns["intensity"] = rng.integers(0, 256, size)
    return found.tobytes() + struct.pack("<I", gps_us) + status


def turning(count: int, seed: int = 1, start: int = 0) -> list[Packet]:
    """`count` regular S2 packets, 0.18 degrees a firing, 288 us apart."""
    rng = np.random.default_rng(seed)
    packets = []
    for p in range(count):
        azimuths = [(start + 18 * (6 * p + i)) % 36000 for i in range(6)]
        blocks = [(flag, azimuth) for azimuth in azimuths for flag in (UPPER, LOWER)]
        packets.append(Packet(payload(blocks, rng, gps_us=288 * p), 1_700_000_000_000_000_000 + 288_000 * p))
    return packets


def read_plain_pcap(path: Path) -> list[Packet]:
    """Payloads of 1206 bytes of a little-endian Ethernet pcap (or .pcap.xz); not the package's own reader."""
    data = lzma.decompress(path.read_bytes()) if path.suffix == ".xz" else path.read_bytes()
    packets, at = [], 24
    while at + 16 <= len(data):
        seconds, micros, size, _ = struct.unpack_from("<4I", data, at)
        body = data[at + 16 + 42 : at + 16 + size]
        if len(body) == 1206:
            packets.append(Packet(body, seconds * 10**9 + micros * 1000))
        at += 16 + size
    return packets
