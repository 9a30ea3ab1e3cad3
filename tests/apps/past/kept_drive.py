"""A keeper with a few frames, and what belongs to it, for tests."""

from __future__ import annotations

from pathlib import Path

from lidarcodec.apps.past.keeper import Keep, Keeper
from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.pipeline import frames_of
from lidarcodec.transport.keys import StreamKeys
from tests.apps.streams import START_NS, Loop
from tests.recording.test_recording import message
from tests.transport.test_contract import eventually

KEYS = StreamKeys("car-7", "roof")
FRAME_NS = 348 * 288_000
SMALL = 8 * 2**20
"""The smallest ring: eight files of 1 MiB."""


def frames(count: int, first: int = 0) -> list[Frame]:
    """Frames of the smooth world, a tenth of a second apart."""
    loop = Loop(count, first=first)
    return list(frames_of(loop.packets(), loop.sensor))


def packets(count: int, first: int = 0) -> list[Packet]:
    """The packets of these frames."""
    return list(Loop(count, first=first).packets())


def feed(keeper: Keeper, given: list[Frame]) -> None:
    """Have frames kept, none of them dropped."""
    for number, frame in enumerate(given):
        keeper.frame(frame)
        if number % 10 == 9:
            assert eventually(lambda: not keeper._queue)


def kept(folder: Path, count: int, max_bytes: int = SMALL, first: int = 0) -> Keeper:
    """A keeper that kept so many frames, and was closed."""
    keeper = Keeper(Keep(folder, max_bytes), KEYS)
    keeper.start()
    feed(keeper, frames(count, first))
    keeper.close()
    return keeper


def big(number: int) -> bytes:
    """A message of 100 kB that no decoder takes; every tenth is a key message."""
    return message(number, number % 10 == 0, size=100_000, stamp_ns=at(number))


def ring(folder: Path, first: int, end: int, max_bytes: int = SMALL) -> Keeper:
    """A keeper into whose files big messages were written."""
    keeper = Keeper(Keep(folder, max_bytes), KEYS)
    for number in range(first, end):
        keeper._files.write(big(number))
    keeper._files.close()
    return keeper


def at(number: float) -> int:
    """Stamp of a frame."""
    return START_NS + int(number * FRAME_NS)
