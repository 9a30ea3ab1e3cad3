"""Assembler: packets in, frames out. A frame is a whole number of packets (docs/decisions/0001)."""

from __future__ import annotations

from collections import Counter

import numpy as np

from lidarcodec import _native
from lidarcodec.assembly.continuity import count_discontinuities
from lidarcodec.errors import PacketError
from lidarcodec.frame import Frame
from lidarcodec.packet import FirstPacket, Packet
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import settings_from
from lidarcodec.side import SideInfo
from lidarcodec.units import AZIMUTH_TURN, MAX_PACKETS, PACKET_BYTES


class Assembler:
    """Cuts a stream of packets into frames. Pure: no clock, no I/O.

    framing: `packets` (348 a frame), `packets:N`, or `revolution` (a new frame begins with the first packet that begins
    behind the wrap of the azimuth, or after 2048 packets without one). A FirstPacket always begins a frame.
    counts: packets, frames, and what was not as it should be: `irregular blocks` (unknown flag or azimuth, kept as they
    are), `lost packets`, `repeated packets`, `time jumps` (as the packets' own clock tells).
    """

    def __init__(self, sensor: SensorModel, framing: str = "packets", first_index: int = 0) -> None:
        self.sensor = sensor
        self.counts: Counter[str] = Counter()
        self._frame_packets = settings_from({"framing": framing}).frame_packets
        self._index = first_index
        self._payloads: list[bytes] = []
        self._stamps: list[int] = []
        self._last_azimuth = -1
        self._last_payload = b""
        self._last_gps: int | None = None

    def push(self, packet: Packet) -> Frame | None:
        """Take one packet; the frame it completed, if it did.

        Raises PacketError, and keeps everything as it was, when the payload is not 1206 bytes.
        """
        payload = packet.payload
        if len(payload) != PACKET_BYTES:
            raise PacketError(f"a packet has {PACKET_BYTES} bytes, this payload has {len(payload)}")
        frame = self._begin_anew() if isinstance(packet, FirstPacket) else None
        if self._frame_packets is None and self._ends_before(payload):
            frame = self.flush() or frame
        if payload == self._last_payload:
            self.counts["repeated packets"] += 1
        self._last_payload = payload
        self._payloads.append(payload)
        self._stamps.append(packet.stamp_ns)
        return self.flush() if len(self._payloads) == self._frame_packets else frame  # never two: then none waited

    @property
    def waiting(self) -> int:
        """Packets that wait for the rest of their frame."""
        return len(self._payloads)

    def flush(self) -> Frame | None:
        """The frame of the packets that are waiting; None if there are none."""
        if not self._payloads:
            return None
        arrays = _native.assemble(b"".join(self._payloads), self.sensor.ring_of_laser.astype(np.uint8))
        range_, intensity, azimuth, fired, layouts, layout, irregular, second, gps_us, status = arrays
        stamps = np.array(self._stamps, np.int64)
        self._payloads, self._stamps = [], []
        self.counts["packets"] += len(stamps)
        self.counts["frames"] += 1
        if len(irregular):
            self.counts["irregular blocks"] += len(irregular)
        self.counts.update(count_discontinuities(gps_us, self._last_gps))
        self._last_gps = int(gps_us[-1])
        side = SideInfo(stamps - stamps[0], gps_us, status, layouts, layout, irregular, second)
        self._index += 1
        return Frame(
            self._index - 1, int(stamps[0]), range_, intensity, azimuth, fired.view(np.bool_), self.sensor, side
        )

    def _begin_anew(self) -> Frame | None:
        """Another sender: the frame of the one before, and nothing of it is compared with what comes."""
        frame = self.flush()
        self._last_azimuth, self._last_payload, self._last_gps = -1, b"", None
        return frame

    def _ends_before(self, payload: bytes) -> bool:
        """Whether a revolution ends before this packet."""
        azimuth = payload[2] | payload[3] << 8
        if azimuth >= AZIMUTH_TURN:
            return len(self._payloads) >= MAX_PACKETS
        wrapped = azimuth < self._last_azimuth - AZIMUTH_TURN // 2
        self._last_azimuth = azimuth
        return wrapped or len(self._payloads) >= MAX_PACKETS
