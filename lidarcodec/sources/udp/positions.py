"""PositionListener: the position packets of a live sensor, ordered among its data packets by times of arrival.

A sensor sends some 250 a second. The kernel buffers seconds of them, so no thread is needed: the call that takes data
packets takes position packets, too. When another sender appears on this port, a filter in the kernel drops its packets,
so that a flood fills neither the buffer nor the interpreter's time.
"""

from __future__ import annotations

import logging
import socket
import struct
from collections import Counter, deque
from ipaddress import ip_address
from typing import Final

from lidarcodec.errors import SourceError
from lidarcodec.packet import Packet
from lidarcodec.sources.udp.socket import SO_RXQ_OVFL, SO_TIMESTAMPNS, dropped, open_socket, take_only_from
from lidarcodec.units import MAX_POSITION_BYTES, MAX_POSITIONS, POSITION_PORTS

logger = logging.getLogger(__name__)

_STAMP: Final = struct.Struct("@qq")
_DROPS: Final = struct.Struct("@I")
_CONTROL_BYTES: Final = socket.CMSG_SPACE(_STAMP.size) + socket.CMSG_SPACE(_DROPS.size)

STEPPED_BACK_NS: Final = 10_000_000_000
"""A waiting packet this far ahead of the data came before the clock was set back. Data is at most 5 s late (the queue
of the live source)."""


class PositionListener:
    """Receives on one port of this machine.

    counts: `position packets`, and what was lost: `kernel drops`, `wrong length`, `strangers`
    stranger: address of the first other sender, as text
    """

    def __init__(self, host: str, port: int, *, interface: str | None = None, share: bool = False) -> None:
        """Raises SourceError if the address cannot be listened on."""
        self._socket = open_socket(host, port, interface=interface, share=share, least_bytes=0)
        self._waiting: deque[tuple[Packet, bytes]] = deque()
        self._dropped = 0
        self._tells_drops = dropped(self._socket) is not None
        self._filters = self._tells_drops
        self._only: bytes | None = None
        self.counts: Counter[str] = Counter()
        self.stranger = ""

    def among(self, data: list[Packet], sender: bytes | None, *, anybody: bool = False) -> list[Packet]:
        """The newest data packets, with the position packets that came before and between them.

        sender: address of the sensor; None while it is not known: all packets wait. anybody: take those of all senders
        Position packets after the last data packet wait for the next call.
        """
        before = len(self._waiting)
        self._drain(None if anybody else sender)
        if sender is None and not anybody:
            return data
        merged: list[Packet] = []
        for packet in data:
            while self._waiting and self._is_due(self._waiting[0][0].stamp_ns, packet.stamp_ns):
                self._take(merged, sender, anybody=anybody)
            merged.append(packet)
        if not data:
            for _ in range(before):
                self._take(merged, sender, anybody=anybody)
        return merged

    @staticmethod
    def _is_due(stamp_ns: int, data_ns: int) -> bool:
        """Whether a waiting packet goes before a data packet: it came earlier, or the clock was set back since."""
        return stamp_ns <= data_ns or stamp_ns - data_ns > STEPPED_BACK_NS

    def close(self) -> None:
        """Close the socket; harmless when called twice."""
        self._socket.close()

    def _take(self, merged: list[Packet], sender: bytes | None, *, anybody: bool) -> None:
        packet, own = self._waiting.popleft()
        if anybody or own == sender:
            merged.append(packet)
            self.counts["position packets"] += 1
        else:
            self._refuse(own)

    def _refuse(self, own: bytes) -> None:
        self.counts["strangers"] += 1
        self.stranger = self.stranger or str(ip_address(own))

    def _let_in(self, sender: bytes | None) -> None:
        """Let the kernel filter other senders once there are any. sender: the sensor; None: no filter."""
        wanted = sender if self.counts["strangers"] else None
        if wanted == self._only or not self._filters:
            return
        try:
            take_only_from(self._socket, wanted)
        except OSError as error:  # closed meanwhile, or no filters in this kernel: packets are refused one by one
            logger.debug("the port of position packets has no filter: %s", error)
            self._filters = False
        else:
            self._only = wanted

    def _count_drops(self) -> None:
        """Count kernel drops: `strangers` while the filter is set and the buffer has room, else `kernel drops`."""
        found = dropped(self._socket) if self._tells_drops else None
        if found is None:
            return
        total, filling = found
        if total != self._dropped:
            cause = "strangers" if self._only is not None and not filling else "kernel drops"
            self.counts[cause] += (total - self._dropped) & 0xFFFFFFFF
            self._dropped = total

    def _drain(self, sender: bytes | None) -> None:
        """Take packets from the kernel, up to a limit. sender: the only sender to take from."""
        self._count_drops()
        self._let_in(sender)
        self._read(sender)
        self._let_in(sender)

    def _read(self, sender: bytes | None) -> None:
        for _ in range(MAX_POSITIONS - len(self._waiting)):
            try:
                payload, control, flags, address = self._socket.recvmsg(MAX_POSITION_BYTES, _CONTROL_BYTES)
            except OSError:  # nothing there, or closed meanwhile
                return
            stamp_ns = self._told(control)
            if flags & socket.MSG_TRUNC:
                self.counts["wrong length"] += 1
                continue
            own = _address(address[0])
            if sender is not None and own != sender:
                self._refuse(own)
                continue
            self._waiting.append((Packet(payload, stamp_ns, position=True), own))

    def _told(self, control: list[tuple[int, int, bytes]]) -> int:
        """The kernel's time of arrival in ns; also counts its drops."""
        stamp_ns = 0
        for level, kind, value in control:
            if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS and len(value) >= _STAMP.size:
                seconds, ns = _STAMP.unpack_from(value)
                stamp_ns = seconds * 1_000_000_000 + ns
            elif self._tells_drops:
                continue
            elif level == socket.SOL_SOCKET and kind == SO_RXQ_OVFL and len(value) >= _DROPS.size:
                (total,) = _DROPS.unpack_from(value)
                self.counts["kernel drops"] += (total - self._dropped) & 0xFFFFFFFF
                self._dropped = total
        return stamp_ns


def listener_beside(
    host: str, data_port: int, port: int | None, *, interface: str | None, share: bool
) -> PositionListener | None:
    """A listener for position packets of the sensor at a data port; None for none.

    port: of position packets, 0 for none; None: the usual one beside a sensor's usual data port (`POSITION_PORTS`),
          with a warning if that cannot be had; none beside another data port
    Raises SourceError if a port that was named cannot be listened on.
    """
    wanted = POSITION_PORTS.get(data_port, 0) if port is None else port
    try:
        return PositionListener(host, wanted, interface=interface, share=share) if wanted else None
    except SourceError as error:
        if port is not None:
            raise
        logger.warning(
            "position packets of the sensor cannot be received: %s. To leave them out, add ?position=off", error
        )
        return None


def _address(text: str) -> bytes:
    """An address as 4 or 16 bytes; an IPv4-mapped IPv6 address as 4, like in the receiver of data packets."""
    address = ip_address(text.partition("%")[0])
    mapped = getattr(address, "ipv4_mapped", None)
    return (mapped or address).packed
