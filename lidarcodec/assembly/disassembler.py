"""Frame -> packets: identical bytes when nothing was reduced or quantised."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.assembly.any_sensor import payloads_of
from lidarcodec.errors import SectionError
from lidarcodec.filling import measured_only
from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.packet_rest import PacketRest
from lidarcodec.side import Position
from lidarcodec.units import PACKET_BYTES


def packets_of(frame: Frame) -> list[Packet]:
    """The data and position packets of a frame, in order, with their host times.

    Returns that a reducer dropped or a receiver interpolated are written as no return.

    Raises SectionError when the frame has no side information, or one that does not fit its images.
    """
    side = frame.side
    if side is None:
        raise SectionError("this frame has no side information, so it cannot be turned back into packets")
    frame = measured_only(frame)
    if isinstance(side, PacketRest):
        return _with_positions(payloads_of(frame), side.packet_ns, side.positions, frame.stamp_ns)
    range_, intensity = frame.range_u16, frame.intensity
    if frame.keep is not None:
        range_ = np.where(frame.keep, range_, np.uint16(0))
        intensity = np.where(frame.keep, intensity, np.uint8(0))
    payloads = _native.disassemble(
        range_,
        intensity,
        frame.azimuth,
        frame.fired.view(np.uint8),
        side.layouts,
        side.layout,
        side.irregular,
        side.second,
        side.gps_us,
        side.status,
        frame.sensor.ring_of_laser.astype(np.uint8),
    )
    parts = [payloads[start : start + PACKET_BYTES] for start in range(0, len(payloads), PACKET_BYTES)]
    return _with_positions(parts, side.packet_ns, side.positions, frame.stamp_ns)


def _with_positions(
    payloads: list[bytes], packet_ns: npt.NDArray[np.int64], positions: tuple[Position, ...], stamp_ns: int
) -> list[Packet]:
    """Packets of these payloads and times, with the position packets at their places."""
    packets = [Packet(one, at) for one, at in zip(payloads, (packet_ns + stamp_ns).tolist(), strict=True)]
    for one in reversed(positions):  # from the last on, so that earlier places stay valid
        packets.insert(one.place, Packet(one.payload, one.offset_ns + stamp_ns, position=True))
    return packets
