"""Packets of any sensor beside the HDL-64E -> images of a frame, and back.

The rule that keeps packets exact: `join(split(p)) == p` is checked for every packet. A packet of which this does not
hold, or whose layout is not that of the frame, is *odd*: the frame carries it as it is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.frame_images import images_of, layout_of
from lidarcodec.image_frame import cloud_frame, image_frame
from lidarcodec.packet_rest import PacketRest
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.clouds.grid import GridFinder, grid_of
from lidarcodec.sensors.images import MAX_CELLS, Images, PacketLayout, Sensor
from lidarcodec.sensors.models.table import sensor_of
from lidarcodec.side import Position
from lidarcodec.units import MAX_COLUMNS


class _Regular(NamedTuple):
    """Packets of a frame that became images: their places among all of its packets."""

    layout: PacketLayout
    places: npt.NDArray[np.intp]
    images: Images


def frame_of_packets(
    payloads: Sequence[bytes],
    stamps_ns: npt.NDArray[np.int64],
    positions: tuple[Position, ...],
    index: int,
    sensor: SensorModel,
    grids: GridFinder | None = None,
) -> Frame:
    """The frame of these packets, at least one. stamps_ns: (P,) host time of each; grids: of a stream of clouds."""
    if sensor.is_cloud and len(payloads) == 1:
        find = grid_of if grids is None else grids.find
        return cloud_frame(index, int(stamps_ns[0]), payloads[0], sensor, positions, find)
    family = sensor_of(sensor)
    regular = None if family is None else _regular(payloads, family)
    begin_ns = int(stamps_ns[0])
    odd = np.ones(len(payloads), np.bool_)
    if regular is not None:
        odd[regular.places] = False
    places = np.flatnonzero(odd)
    rest = PacketRest(
        "" if regular is None else regular.layout.name,
        stamps_ns - begin_ns,
        places.astype(np.uint16),
        tuple(payloads[place] for place in places.tolist()),
        {} if regular is None else dict(regular.images.series),
        positions,
    )
    return image_frame(index, begin_ns, {} if regular is None else dict(regular.images.planes), rest, sensor)


def payloads_of(frame: Frame) -> list[bytes]:
    """The data packets of a frame.

    Raises SectionError when planes, series and odd packets do not fit together.
    """
    rest = frame.side
    assert isinstance(rest, PacketRest)
    payloads: list[bytes] = [b""] * rest.packets
    for place, payload in zip(rest.odd.tolist(), rest.odd_packets, strict=True):
        payloads[place] = payload
    places = rest.regular
    found = layout_of(frame)
    if found is None:
        if len(places):
            raise SectionError(f"{len(places)} packets without a layout")
        return payloads
    _, layout = found
    joined = layout.join(images_of(frame, layout))
    if len(joined) != len(places):
        raise SectionError(f"images of {len(joined)} packets in a frame of {len(places)}")
    data, size = joined.tobytes(), layout.packet_bytes
    for number, place in enumerate(places.tolist()):
        payloads[place] = data[number * size : (number + 1) * size]
    return payloads


def _regular(payloads: Sequence[bytes], family: Sensor) -> _Regular | None:
    """The packets of the layout that most of these packets have, as far as they can be undone exactly."""
    layout = _layout(payloads, family)
    if layout is None:
        return None
    places = np.array([n for n, one in enumerate(payloads) if len(one) == layout.packet_bytes], np.intp)
    most = min(MAX_COLUMNS, MAX_CELLS // (layout.rows * len(layout.planes)))
    places = places[: most // layout.columns]
    packets = np.frombuffer(b"".join([payloads[n] for n in places]), np.uint8).reshape(len(places), -1)
    fits = layout.fits(packets)
    if not fits.all():
        places, packets = places[fits], packets[fits]
    images = layout.split(packets)
    same = (layout.join(images) == packets).all(axis=1)
    if not same.all():
        places, packets = places[same], packets[same]
        images = layout.split(packets)
    return _Regular(layout, places, images) if len(places) else None


def _layout(payloads: Sequence[bytes], family: Sensor) -> PacketLayout | None:
    """The layout of most packets, by some of them that are spread over the frame."""
    found: Counter[str] = Counter()
    for payload in payloads[:: max(1, len(payloads) // LOOKED_AT)]:
        layout = family.layout_of(payload)
        if layout is not None:
            found[layout.name] += 1
    return family.named_layout(found.most_common(1)[0][0]) if found else None


LOOKED_AT: Final = 8
"""Packets of a frame by which its layout is chosen."""


LATE_TURNS: Final = 2
"""A packet whose number is so little behind the last one's is a late one of an earlier turn."""
MAX_LATE: Final = 64
"""Late packets in a row after which the sensor, or a replay of it, is taken to have begun anew."""


class TurnWatch:
    """Sees in the packets of a sensor when a new turn begins."""

    def __init__(self, sensor: SensorModel) -> None:
        self._family = sensor_of(sensor)
        self._layouts: dict[int, PacketLayout | None] = {}
        self._last = -1
        self._late = 0

    def begins(self, payload: bytes) -> bool:
        """Whether a new turn begins with this packet."""
        size = len(payload)
        layout = self._layouts.get(size)
        if layout is None and self._family is not None and len(self._layouts) < 64:
            layout = self._layouts[size] = self._family.layout_of(payload)
        if layout is None:
            return False
        offset, span, counts = layout.turn
        at = payload[offset] | payload[offset + 1] << 8
        late = counts and self._last >= 0 and 1 <= (self._last - at) % span <= LATE_TURNS
        self._late = self._late + 1 if late else 0
        if at >= span or 0 < self._late <= MAX_LATE:
            return False
        self._late = 0
        begins = 0 <= self._last != at if counts else at < self._last - span // 2
        self._last = at
        return begins

    def forget(self) -> None:
        """Another sensor sends from now on."""
        self._last = -1
