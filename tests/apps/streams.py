"""Sources for the live tests: a few frames of a smooth world, over and over, as long as wanted."""

from __future__ import annotations

import struct
import threading
from collections.abc import Iterator
from functools import cache

import numpy as np

from lidarcodec.packet import Packet
from lidarcodec.sources.base import PacketSource
from lidarcodec.units import PACKET_BYTES
from tests.packets import LOWER, UPPER, sensor

START_NS = 1_700_000_000_000_000_000


def smooth_payloads(packets: int = 348, seed: int = 3) -> np.ndarray:
    """(packets, 1206) uint8: one turn of S2 packets in a world of walls, a tenth without return."""
    rng = np.random.default_rng(seed)
    azimuth = (np.arange(packets * 6) * 36000 // (packets * 6)).astype(np.uint16)
    rings = np.arange(64)
    world = 3000 + 2500 * np.sin(azimuth[:, None] / 36000 * 2 * np.pi * 5) + 40 * rings[None, :]
    ranges = (world + rng.integers(0, 6, world.shape)).astype(np.uint16) * (rng.random(world.shape) > 0.1)
    intensity = (rings[None, :] * 2 + rng.integers(0, 8, world.shape)).astype(np.uint8)
    out = np.zeros((packets, PACKET_BYTES), np.uint8)
    for block in range(12):
        firing, half = divmod(block, 2)
        rows = np.arange(packets) * 6 + firing
        view = out[:, block * 100 : block * 100 + 100]
        view[:, :2] = np.frombuffer(struct.pack("<H", LOWER if half else UPPER), np.uint8)
        view[:, 2:4] = azimuth[rows].astype("<u2")[:, None].view(np.uint8)
        cells = view[:, 4:].reshape(packets, 32, 3)
        lasers = slice(32 * half, 32 * half + 32)
        cells[:, :, :2] = ranges[rows][:, lasers].astype("<u2")[..., None].view(np.uint8)
        cells[:, :, 2] = intensity[rows][:, lasers]
    return out


@cache
def smooth_turn(*, whole: bool = False) -> tuple[bytes, ...]:
    """The same without the tails, unless whole with returns in a sixth of it: what a test costs is for the others."""
    turn = smooth_payloads()
    if not whole:
        turn[len(turn) // 6 :, :1200].reshape(-1, 12, 100)[..., 4:] = 0
    return tuple(row.tobytes()[:1200] for row in turn)


class Loop(PacketSource):
    """`frames` frames of 348 packets (endless without); packet times run on, every packet is different.

    whole: there are returns all around, as where a bitrate is to be large
    """

    def __init__(self, frames: int | None = None, *, first: int = 0, whole: bool = False) -> None:
        super().__init__(sensor())
        self.frames, self.first = frames, first
        self._turn = smooth_turn(whole=whole)
        self._stop = threading.Event()

    def packets(self) -> Iterator[Packet]:
        number = 348 * self.first
        while (self.frames is None or number < 348 * (self.first + self.frames)) and not self._stop.is_set():
            gps_us = number * 288 % 3_600_000_000
            tail = struct.pack("<IBB", gps_us, ord("H"), number % 60)
            yield Packet(self._turn[number % 348] + tail, START_NS + number * 288_000)
            number += 1

    def payloads(self) -> list[bytes]:
        return [packet.payload for packet in self.packets()]

    def close(self) -> None:
        self._stop.set()


class Broken(Loop):
    """A source that fails after a frame and a half."""

    def packets(self) -> Iterator[Packet]:
        for number, packet in enumerate(super().packets()):
            if number == 500:
                raise RuntimeError("the cable was cut")
            yield packet
