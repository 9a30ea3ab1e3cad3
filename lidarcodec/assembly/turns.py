"""Turns that came in parts (`framing=parts:N`), put together again.

A turn is given when its last part is there. Where a part is missing, what came before it is given as soon as the next
turn begins. A part that does not fit the turn begins a new one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from lidarcodec.errors import LidarCodecError
from lidarcodec.frame import WHOLE, Frame
from lidarcodec.settings import MAX_PARTS
from lidarcodec.side import Position, SideInfo
from lidarcodec.units import MAX_COLUMNS

LONGEST_NS: Final = 60 * 10**9
"""Between the stamps of two parts of a turn. A turn takes a fraction of a second, so a clock was set between them."""


class TurnJoiner:
    """Parts of turns in, turns out. Other frames pass. It raises nothing, and holds no more than one turn."""

    def __init__(self) -> None:
        self._parts: list[Frame] = []

    def add(self, frame: Frame) -> list[Frame]:
        """The turns that are complete with this frame, and one before it that will never be."""
        turns = [] if self._fits(frame) else self.flush()
        self._parts.append(frame)
        return turns if frame.part.more else turns + self.flush()

    def flush(self) -> list[Frame]:
        """What came of a turn at the end of a stream. Parts that make no valid frame together are given one by one."""
        parts, self._parts = self._parts, []
        try:
            return [joined(parts)] if parts else []
        except LidarCodecError:
            return [one.with_(part=WHOLE) for one in parts]

    def _fits(self, frame: Frame) -> bool:
        """Whether a frame goes on from the parts that are here, and there is room for it beside them."""
        if not self._parts:
            return True
        first, before = self._parts[0], self._parts[-1]
        return (
            frame.part.goes_on
            and frame.index == before.index + 1
            and len(self._parts) < MAX_PARTS
            and sum(one.width for one in self._parts) + frame.width <= MAX_COLUMNS
            and abs(frame.stamp_ns - first.stamp_ns) <= LONGEST_NS
            and not _differ((first, frame))
        )


def _differ(parts: Sequence[Frame]) -> bool:
    """Whether frames are no parts of one turn: of different sensors, or reduced."""
    sensor = parts[0].sensor
    of = (sensor.hash, sensor.convention)
    return any(
        (one.sensor.hash, one.sensor.convention) != of or one.keep is not None or one.lattice is not None
        for one in parts
    )


def joined(parts: Sequence[Frame]) -> Frame:
    """Consecutive frames of an HDL-64E as one, with index, stamp, pose and mounting of the first.

    Raises LidarCodecError for frames that are no parts of one turn: of different sensors, or reduced, or too many.
    """
    first = parts[0]
    if len(parts) == 1:
        return first if first.part == WHOLE else first.with_(part=WHOLE)
    if _differ(parts):
        raise LidarCodecError("frames of different sensors, or reduced frames, cannot be joined into one turn")
    return Frame(
        first.index,
        first.stamp_ns,
        np.hstack([one.range_u16 for one in parts]),
        np.hstack([one.intensity for one in parts]),
        np.hstack([one.azimuth for one in parts]),
        np.hstack([one.fired for one in parts]),
        first.sensor,
        _joined_side(parts),
        pose=first.pose,
        mount=first.mount,
    )


def _joined_side(parts: Sequence[Frame]) -> SideInfo | None:
    """The side information of all; None if one has none."""
    sides = [side for one in parts if (side := one.blocks) is not None]
    if len(sides) < len(parts):
        return None
    places: dict[bytes, int] = {}
    layout = [
        np.array([places.setdefault(one.tobytes(), len(places)) for one in side.layouts], np.uint16)[side.layout]
        for side in sides
    ]
    begin_ns, before = parts[0].stamp_ns, 0
    packet_ns, positions = [], []
    for part, side in zip(parts, sides, strict=True):
        later_ns = part.stamp_ns - begin_ns
        packet_ns.append(side.packet_ns + later_ns)
        positions += [Position(one.place + before, one.offset_ns + later_ns, one.payload) for one in side.positions]
        before += side.packets
    return SideInfo(
        np.concatenate(packet_ns),
        np.concatenate([side.gps_us for side in sides]),
        np.concatenate([side.status for side in sides]),
        np.array([np.frombuffer(one, np.uint8) for one in places], np.uint8).reshape(len(places), -1),
        np.concatenate(layout),
        np.concatenate([side.irregular for side in sides]),
        np.concatenate([side.second for side in sides]),
        tuple(positions),
    )
