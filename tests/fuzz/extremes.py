"""Frames at the edges of what a sensor can send: narrowest, widest, a rotor that stands still, all and no returns.

Each function gives the frames of a short stream. The same seed gives the same frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import islice
from typing import Any

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.pipeline import frames_of
from lidarcodec.sensor_model import Calibration
from lidarcodec.side import Position, Role, SideInfo
from lidarcodec.sources import open_source
from lidarcodec.units import BLOCKS_PER_PACKET, LASERS, MAX_COLUMNS, MAX_PACKETS, MAX_POSITION_BYTES, MAX_POSITIONS
from tests.contracts import frames
from tests.positions import of_frame, payload


def _constant(base: Frame, value: int, intensity: int) -> dict[str, Any]:
    shape = base.range.shape
    return {"range": np.full(shape, value, np.uint16), "intensity": np.full(shape, intensity, np.uint8)}


def small(seed: int, packets: int = 2) -> list[Frame]:
    """Frames of a few columns, each extreme in its own way; indices rise, so that they are one stream."""
    rng = np.random.default_rng(seed)
    base = frames.scene(packets, seed=seed)
    width, last = base.width, np.iinfo(np.int64).max
    checked = (np.add.outer(np.arange(LASERS), np.arange(width)) % 2).astype(np.uint16)
    wild = Calibration(rng.integers(-(2**31), 2**31, base.sensor.calibration.table.shape).astype(np.int32))
    turned = rng.integers(0, 36000, (2, width)).astype(np.uint16)
    none = {name: getattr(base, name)[:, :0] for name in ("range", "intensity", "azimuth", "fired")}
    one = {name: getattr(base, name)[:, :1] for name in ("range", "intensity", "azimuth", "fired")}
    made = [
        base,
        frames.scene(packets, seed=seed, index=1),
        base.with_(**_constant(base, 65535, 255)),
        base.with_(**_constant(base, 1, 0)),
        frames.scene(packets, seed=seed, holes=1.0),
        frames.noise(packets, seed=seed),
        frames.one_return(packets),
        base.with_(range=65535 * checked, intensity=(255 * checked).astype(np.uint8)),
        base.with_(azimuth=np.full((2, width), 35999, np.uint16)),  # the rotor stands still
        base.with_(azimuth=np.ascontiguousarray(base.azimuth[:, ::-1])),  # and turns back
        base.with_(azimuth=turned),
        frames.three_to_one(packets),
        frames.irregular_side(packets),
        base.with_(intensity=rng.integers(0, 256, base.range.shape).astype(np.uint8)),
        base.with_(pose=frames.pose(seed)),
        base.with_(side=None, **none),
        base.with_(side=SideInfo.regular(0), **none),
        base.with_(side=None, **one),
        base.with_(sensor=base.sensor.with_convention("veloview")),
        base.with_(sensor=frames.sensor(seed + 1)),
        base.with_(sensor=type(base.sensor)("", wild, "given", "ros", 429.4967295)),
        base.with_(stamp_ns=-last),
        base.with_(stamp_ns=last),
        frames.scene(packets, seed=seed, holes=0.0),
        _with_positions(base, rng),
    ]
    return _numbered(made)


def _with_positions(base: Frame, rng: np.random.Generator) -> Frame:
    """The frame with position packets before its first data packet, between two and behind the last one."""
    assert base.side is not None
    places = (0, base.side.packets // 2, base.side.packets)
    sizes = (512, 0, MAX_POSITION_BYTES)
    positions = tuple(Position(place, place, rng.bytes(size)) for place, size in zip(places, sizes, strict=True))
    return base.with_(side=replace(base.side, positions=positions))


def still(seed: int, packets: int) -> list[Frame]:
    """A rotor that stands still: every firing in one direction, of one range, and then of noise."""
    base = frames.scene(packets, seed=seed)
    stand = np.full((2, base.width), 17999, np.uint16)
    return _numbered(
        [
            base.with_(azimuth=stand, **_constant(base, 5000, 80)),
            frames.noise(packets, seed=seed).with_(azimuth=stand),
            base.with_(azimuth=stand),
        ]
    )


def positions(seed: int) -> list[Frame]:
    """Frames with position packets: as a sensor sends them, of odd sizes, the largest, many small ones, none."""
    rng = np.random.default_rng(seed)
    sizes = ((MAX_POSITION_BYTES, 0, 1), (MAX_POSITION_BYTES,) * 30, (), (0,) * MAX_POSITIONS)
    made = []
    for index, of in enumerate(sizes):
        frame = frames.scene(2, seed=seed, index=index)
        assert frame.side is not None
        some = tuple(Position(k * 2 // len(of), 1000 * k, rng.bytes(size)) for k, size in enumerate(of))
        sent = tuple(Position(k // 20, 1000 * k, payload(frame.stamp_ns + 1000 * k)) for k in range(40))
        odd = of_frame(2, every=1)
        made += [frame.with_(side=replace(frame.side, positions=each)) for each in (sent, odd, some)]
    return _numbered(made)


@cache
def driven(packets: int, count: int, skip: int = 0) -> list[Frame]:
    """Frames of a simulated drive, `packets` in each."""
    with open_source("sim:city?frames=4") as source:
        some = islice(source.packets(), skip, skip + packets * count)
        return list(frames_of(some, source.sensor, f"packets:{packets}"))


def widest(seed: int) -> list[Frame]:
    """The widest frames there are, 24,576 columns: every block of 2048 packets opens one. Nothing, then one plane."""
    columns = np.arange(MAX_COLUMNS)
    upper = columns % 2 == 0
    roles = np.array([[Role.UPPER_OPENS, Role.LOWER_OPENS] * (BLOCKS_PER_PACKET // 2)], np.uint8)
    regular = SideInfo.regular(MAX_PACKETS)
    side = SideInfo(
        packet_ns=regular.packet_ns.copy(),
        gps_us=regular.gps_us.copy(),
        status=regular.status.copy(),
        layouts=roles,
        layout=regular.layout.copy(),
        irregular=regular.irregular.copy(),
        second=regular.second.copy(),
    )
    fired = np.stack([upper, ~upper])
    cells = fired[(frames.SENSOR.laser_of_ring >= 32).astype(int)]
    nothing = frames.scene(1, seed=seed).with_(
        range=np.zeros(cells.shape, np.uint16),
        intensity=np.zeros(cells.shape, np.uint8),
        azimuth=np.tile((columns * 7 % 36000).astype(np.uint16), (2, 1)),
        fired=fired,
        side=side,
    )
    plane = np.where(cells, 3000 + 200 * np.arange(LASERS)[:, None], 0).astype(np.uint16)
    return _numbered([nothing, nothing.with_(range=plane, intensity=np.where(cells, 255, 0).astype(np.uint8))])


def _numbered(made: list[Frame]) -> list[Frame]:
    return [frame.with_(index=index) for index, frame in enumerate(made)]


Frames = Callable[[int], list[Frame]]
SIZES: dict[str, Frames] = {
    "extremes": small,
    "tiny": lambda seed: driven(1, 4, 7 * seed % 90),
    "slab": lambda seed: driven(29, 3, 31 * seed % 90),
    "full-size": lambda seed: driven(348, 3),
    "still": lambda seed: still(seed, 12),
    "positions": positions,
    "widest": widest,
}
"""How to make the frames of a stream, by their size."""
