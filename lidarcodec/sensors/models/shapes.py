"""What packets of each sensor look like, for the choice of a live sender (native/src/packets/udp_senders.hpp)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Final, NamedTuple

from lidarcodec.sensors.images import PacketLayout
from lidarcodec.sensors.models.ouster.sensor import bare_sensors
from lidarcodec.sensors.models.table import OUSTERS, block_sensors

MAX_MARKS: Final = 16
"""Most bytes by which a packet is recognised."""


class Shape(NamedTuple):
    """What packets of one layout look like. The native receiver takes it as a plain tuple.

    turn_offset, turn_span, turn_counts: those of its `Turn`
    marks:  offset and value of each byte by which a packet is recognised, in turn
    wanted: whether such packets are evidence of the sensor that is looked for
    """

    packet_bytes: int
    turn_offset: int
    turn_span: int
    turn_counts: bool
    marks: list[int]
    wanted: bool


@cache
def shapes(wanted: str | None = None) -> tuple[Shape, ...]:
    """The shapes of the packets of all sensors beside the HDL-64E.

    wanted: the model that is looked for; None: any
    """
    found = (_shape(layout, wanted in (None, model)) for model, layout in _layouts(wanted))
    return tuple(sorted(found, key=lambda shape: not shape.wanted))  # of two models with one layout, the one wanted


def _layouts(wanted: str | None) -> Iterator[tuple[str | None, PacketLayout]]:
    """Layouts, each with its model. Packets of an Ouster show the number of its beams only."""
    for sensor in block_sensors():
        yield from ((sensor.name, layout) for layout in sensor.layouts)
    for name, bare in bare_sensors().items():
        fits = wanted in OUSTERS and str(wanted).endswith(f"-{bare.layout.rows}")
        yield wanted if fits else name, bare.layout


def _shape(layout: PacketLayout, wanted: bool) -> Shape:
    marks = [number for mark in layout.marks[:MAX_MARKS] for number in mark]
    turn = layout.turn
    return Shape(layout.packet_bytes, turn.offset, turn.span, turn.counts, marks, wanted)
