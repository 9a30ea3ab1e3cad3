"""Assembler: packets in, frames out. A frame is a whole number of packets (docs/decisions/0001)."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from lidarcodec import _native
from lidarcodec.assembly.any_sensor import TurnWatch, frame_of_packets
from lidarcodec.assembly.continuity import count_discontinuities
from lidarcodec.assembly.rotation import PartWatch, RotationWatch
from lidarcodec.errors import PacketError
from lidarcodec.frame import Frame, Part
from lidarcodec.frame_images import odd_count
from lidarcodec.packet import UNKEPT_POSITIONS, FirstPacket, LastPacket, Packet
from lidarcodec.packet_rest import MAX_ODD_BYTES, MAX_ODD_TOTAL
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.clouds.grid import GridFinder
from lidarcodec.sensors.models.table import PACKETS
from lidarcodec.settings import settings_from
from lidarcodec.side import Position, SideInfo
from lidarcodec.units import (
    MAX_PACKETS,
    MAX_POSITION_BYTES,
    MAX_POSITIONS,
    MAX_POSITIONS_BYTES,
    PACKET_BYTES,
)

MAX_FRAME_BYTES = 16 * 2**20
"""Most bytes of the packets of a frame; a turn of the largest sensor has a third of it."""
TURN_NS = 100_000_000
"""Length of a frame of packets that do not say where a turn ends: the turn of a sensor at 10 Hz."""


class Assembler:
    """Cuts a stream of packets into frames. Pure: no clock, no I/O.

    framing: `revolution` (a turn: a new frame begins with the first packet after the azimuth wraps, or after 2048
    packets without a wrap), `packets` (348 a frame; of other sensors than an HDL-64E a turn), `packets:N`, or `parts:N`
    (of an HDL-64E a turn in N frames, `part_ends`; of other sensors a turn). A
    FirstPacket always begins a frame. If the azimuth wraps within the first packet, the first turn has this packet too.
    A LastPacket ends a turn.
    counts: `packets`, `frames`, and irregularities: `irregular blocks` (unknown flag or azimuth; they are kept
    unchanged), `repeated packets`, `lost packets` and `time jumps` (both by the packets' own clock), and `position
    packets not kept` (more than a frame holds, or without a frame). Of other sensors: `odd packets` (of another layout
    than the rest of their frame; they are kept unchanged). A sensor whose packets do not say where a turn ends gets a
    frame every 0.1 s with `revolution`.
    """

    def __init__(self, sensor: SensorModel, framing: str = "revolution", first_index: int = 0) -> None:
        self.counts: Counter[str] = Counter()
        self._framing = framing
        self._use(sensor)
        self._index = first_index
        self._grids = GridFinder()
        self._payloads: list[bytes] = []
        self._stamps: list[int] = []
        self._bytes = 0
        self._positions: list[tuple[int, Packet]] = []
        self._position_bytes = 0
        self._rotation = RotationWatch()
        self._part = PartWatch(settings_from({"framing": framing}).parts)
        self._goes_on = False
        self._last_payload = b""
        self._last_gps: int | None = None

    def _use(self, sensor: SensorModel) -> None:
        self.sensor = sensor
        self._turns = None if sensor.is_hdl64e else TurnWatch(sensor)
        self._frame_packets = settings_from({"framing": self._framing}).frame_packets
        if self._framing == "packets" and not sensor.is_hdl64e:
            self._frame_packets = None  # a turn: how many packets it has is each sensor's own
        if sensor.is_cloud:
            self._frame_packets = 1

    def push(self, packet: Packet) -> Frame | None:
        """Take one packet; returns the frame that it completed, if any. A position packet completes none.

        Raises PacketError, and changes nothing, when the payload of a data packet is not 1206 bytes (HDL-64E), or is
        longer than UDP allows (other sensors), or than 32 MiB (point clouds, of which each message is a frame).
        """
        if packet.position:
            self._push_position(packet)
            return None
        payload = packet.payload
        self._check_size(len(payload))
        frame = self._begin_anew() if isinstance(packet, FirstPacket) else None
        ends = self._frame_packets is None and self._ends_before(payload, packet.stamp_ns)
        more = self._turns is None and self._part.begins(payload, turn=ends or not self._payloads) and not ends
        if ends or more or self._bytes + len(payload) > MAX_FRAME_BYTES:
            frame = self._cut(more=more) if self._payloads else frame
        if payload == self._last_payload:
            self.counts["repeated packets"] += 1
        self._last_payload = payload
        self._payloads.append(payload)
        self._bytes += len(payload)
        self._stamps.append(packet.stamp_ns)
        # At most one frame: frames of one packet leave nothing waiting that `_begin_anew` could cut.
        full = len(self._payloads) == self._frame_packets
        ended = self._frame_packets is None and frame is None and isinstance(packet, LastPacket)
        return self._cut() if full or ended else frame

    def follow(self, sensor: SensorModel) -> Frame | None:
        """Take packets of another sensor from now on, if it is one; returns the frame of the packets that are waiting.

        A new calibration of the same HDL-64E is none: it needs a new assembler, between two frames.
        """
        if sensor is self.sensor or (
            sensor.model == self.sensor.model and (sensor.is_hdl64e or sensor.hash == self.sensor.hash)
        ):
            return None
        frame = self._begin_anew()
        self._use(sensor)
        return frame

    @property
    def waiting(self) -> int:
        """Number of packets that wait for the rest of their frame."""
        return len(self._payloads)

    def flush(self) -> Frame | None:
        """The frame of the packets that are waiting; None if there are none."""
        if self._payloads:
            return self._cut()
        self._forget_positions()
        return None

    def flush_onto(self, last: Frame | None) -> list[Frame]:
        """The frames at the end of a stream: `last`, the frame given last, and the frame of the waiting packets.

        If only position packets are waiting, they are added to `last`.
        """
        if self._payloads or not self._positions or last is None or last.side is None:
            return [frame for frame in (last, self.flush()) if frame is not None]
        side, room = last.side, MAX_POSITIONS - len(last.side.positions)
        bytes_left = MAX_POSITIONS_BYTES - sum(len(one.payload) for one in side.positions)
        more: list[Position] = []
        for _, packet in self._positions:
            if len(more) < room and len(packet.payload) <= bytes_left:
                bytes_left -= len(packet.payload)
                more.append(Position(side.packets, packet.stamp_ns - last.stamp_ns, packet.payload))
        del self._positions[: len(more)]
        self._forget_positions()
        return [last.with_(side=replace(side, positions=(*side.positions, *more)))]

    def _cut(self, *, more: bool = False) -> Frame:
        """The frame of the packets that are waiting. more: a part of a turn, of which another part follows"""
        part, self._goes_on = Part(self._goes_on, more), more
        if self._turns is not None:
            return self._cut_other()
        arrays = _native.assemble(b"".join(self._payloads), self.sensor.ring_of_laser.astype(np.uint8))
        range_, intensity, azimuth, fired, layouts, layout, irregular, second, gps_us, status = arrays
        stamps = np.array(self._stamps, np.int64)
        begin_ns = self._stamps[0]
        positions = tuple(
            Position(place, packet.stamp_ns - begin_ns, packet.payload) for place, packet in self._positions
        )
        self._payloads, self._stamps, self._positions = [], [], []
        self._bytes = self._position_bytes = 0
        self.counts["packets"] += len(stamps)
        self.counts["frames"] += 1
        if len(irregular):
            self.counts["irregular blocks"] += len(irregular)
        self.counts.update(count_discontinuities(gps_us, self._last_gps))
        self._last_gps = int(gps_us[-1])
        side = SideInfo(stamps - begin_ns, gps_us, status, layouts, layout, irregular, second, positions)
        self._index += 1
        return Frame(
            self._index - 1, begin_ns, range_, intensity, azimuth, fired.view(np.bool_), self.sensor, side, part=part
        )

    def _cut_other(self) -> Frame:
        """The frame of the packets that are waiting, of another sensor than an HDL-64E."""
        begin_ns = self._stamps[0]
        positions = tuple(
            Position(place, packet.stamp_ns - begin_ns, packet.payload) for place, packet in self._positions
        )
        stamps_ns = np.array(self._stamps, np.int64)
        frame = frame_of_packets(self._payloads, stamps_ns, positions, self._index, self.sensor, self._grids)
        self.counts["packets"] += len(self._payloads)
        self.counts["frames"] += 1
        if (odd := odd_count(frame)) and frame.width:
            self.counts["odd packets"] += odd
        self._payloads, self._stamps, self._positions = [], [], []
        self._bytes = self._position_bytes = 0
        self._index += 1
        return frame

    def _check_size(self, size: int) -> None:
        if self._turns is None and size != PACKET_BYTES:
            raise PacketError(f"a packet must have {PACKET_BYTES} bytes, but this payload has {size}")
        if size > MAX_ODD_BYTES and not self.sensor.is_cloud:
            raise PacketError(f"a payload of {size} bytes: UDP ends at {MAX_ODD_BYTES}")
        if size > MAX_ODD_TOTAL:
            raise PacketError(f"a message of {size} bytes: the limit is {MAX_ODD_TOTAL}")

    def _push_position(self, packet: Packet) -> None:
        """Keep a position packet for the frame in progress; count it if there is no room."""
        size = len(packet.payload)
        fits = size <= MAX_POSITION_BYTES and self._position_bytes + size <= MAX_POSITIONS_BYTES
        if not fits or len(self._positions) >= MAX_POSITIONS:
            self.counts[UNKEPT_POSITIONS] += 1
            return
        self._positions.append((len(self._payloads), packet))
        self._position_bytes += size

    def _forget_positions(self) -> None:
        """Drop and count position packets that belong to no frame."""
        if self._positions:
            self.counts[UNKEPT_POSITIONS] += len(self._positions)
            self._positions, self._position_bytes = [], 0

    def _begin_anew(self) -> Frame | None:
        """The frame of the previous sender's waiting packets; its azimuth, payload and clock are forgotten."""
        frame = self._cut() if self._payloads else None
        self._rotation, self._last_payload, self._last_gps = RotationWatch(), b"", None
        if self._turns is not None:
            self._turns.forget()
        return frame

    def _ends_before(self, payload: bytes, stamp_ns: int) -> bool:
        """Whether a revolution ends before this packet."""
        if self._turns is not None:
            full = len(self._payloads) >= MAX_PACKETS
            if self.sensor.model == PACKETS:
                return full or (bool(self._stamps) and stamp_ns - self._stamps[0] >= TURN_NS)
            return self._turns.begins(payload) or full
        return self._rotation.begins(payload)
