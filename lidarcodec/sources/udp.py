"""UdpSource: the packets of a sensor that sends to this machine, live.

A native thread drains the socket into a bounded queue, without the interpreter: a busy program loses nothing for
seconds. What is lost all the same is counted: by the kernel (`kernel drops`), or where the queue was full (`queue
drops`, oldest first).
"""

from __future__ import annotations

import logging
import os
import time
from collections import Counter, deque
from collections.abc import Iterator
from ipaddress import ip_address
from pathlib import Path
from typing import Final

from lidarcodec import _native
from lidarcodec.errors import PacketError, SourceError
from lidarcodec.packet import UNKEPT_POSITIONS, Packet
from lidarcodec.sensors import find_calibration, identify
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.position_socket import listener_beside
from lidarcodec.sources.spec import Spec, address_of
from lidarcodec.sources.table_search import TableSearch
from lidarcodec.sources.udp_socket import open_socket
from lidarcodec.units import DATA_PORT, PACKET_BYTES

logger = logging.getLogger(__name__)

QUEUE_PACKETS: Final = 16_384
"""4.7 s of an HDL-64 in single return, 20 MB."""
BATCH_PACKETS: Final = 1024
TAKE_S: Final = 0.2
"""Longest wait in native code, so that an interrupt of the main thread is seen."""
REFUSED_PACKETS: Final = 64
"""So many packets of another sensor, and none of an HDL-64E, end the source."""
WAIT_S: Final = 2.0
"""A little more than the 1.2 s (4160 packets) in which the table comes round."""


class UdpSource(PacketSource):
    """Packets of one sensor at an address of this machine; the first HDL-64E that sends is the one.

    Counts: `kernel drops`, `queue drops`, `strangers` (packets of other senders), `wrong length`, `position packets`
    (which are given), `position packets not kept` (that came to the port of data), `other sensor`.
    """

    def __init__(
        self,
        host: str,
        port: int = DATA_PORT,
        calibration: Path | None = None,
        *,
        src: str | None = None,
        any_sender: bool = False,
        idle_s: float | None = None,
        wait_s: float = WAIT_S,
        interface: str | None = None,
        share: bool = False,
        position: int | None = None,
    ) -> None:
        """Listens at once.

        src:        take packets of this sender only;  any_sender: take those of all
        idle_s:     `packets` ends when none came for so long
        wait_s:     without a given calibration: how long to wait for the table in the sensor's status bytes (1.2 s);
                    one that comes later replaces `sensor` while packets are read
        position:   port of its position packets, 0 for none; by default 8308 beside port 2368, else none
        Raises SourceError if the address cannot be listened on, PacketError if another sensor sends there,
        CalibrationError.
        """
        super().__init__(find_calibration(None, calibration, ()), live=True)
        wanted = None if src is None else address_of(src)
        sock = open_socket(host, port, interface=interface, share=share)
        with sock:
            self.address: tuple[str, int] = sock.getsockname()[:2]
            self._positions = listener_beside(host, self.address[1], position, interface=interface, share=share)
            self._receiver = _native.UdpReceiver(sock.fileno(), QUEUE_PACKETS)  # on a copy of the socket
        self.label = f"UDP {self.address[0]} port {self.address[1]}"
        self._idle_s, self._any = idle_s, any_sender
        self._wanted = None if wanted is None else wanted.packed
        self._sender: int | None = None
        self._refused: PacketError | None = None
        self._other = self._strangers = 0
        self._held: deque[Packet] = deque()
        self._table = table = TableSearch() if calibration is None else None
        if table is not None:
            try:
                self._await(table, wait_s)
            except BaseException:
                self.close()
                raise

    @classmethod
    def from_spec(cls, spec: Spec, calibration: Path | None) -> UdpSource:
        """The source that `udp://HOST:PORT?src=&any=&idle=&wait=&interface=&share=&position=` names."""
        spec.only("src", "any", "idle", "wait", "interface", "share", "position")
        host, _, port = spec.place.rpartition(":") if not spec.place.endswith("]") else (spec.place, "", "")
        if not host and not port.isdigit():
            host, port = port, ""
        if port and not (port.isdigit() and 0 <= int(port) <= 65535):
            raise SourceError(f"{spec.text}: the port is a number up to 65535")
        return cls(
            host.strip("[]"),
            int(port or DATA_PORT),
            calibration,
            src=spec.options.get("src"),
            any_sender=spec.flag("any"),
            idle_s=spec.number("idle", 0.001, 1e9),
            wait_s=WAIT_S if (wait_s := spec.number("wait", 0.0, 60.0)) is None else wait_s,
            interface=spec.options.get("interface"),
            share=spec.flag("share"),
            position=spec.position_port(),
        )

    def packets(self) -> Iterator[Packet]:
        """Packets as they come, each once, with the kernel's time of arrival; ends when `close` is called, or when none
        came for `idle_s`. Cost: 5 us a packet.

        Raises PacketError if another sensor sends here and no HDL-64E, SourceError if the socket fails.
        """
        heard = time.monotonic()
        while not self.closed:
            if not self._held:
                self._pump(TAKE_S if self._idle_s is None else min(TAKE_S, self._idle_s))
            if self._held:
                while self._held and not self.closed:
                    yield self._held.popleft()
                heard = time.monotonic()
            elif self._idle_s is not None and time.monotonic() - heard >= self._idle_s:
                logger.info("%s: nothing for %g s", self.label, self._idle_s)
                return

    def close(self) -> None:
        """Close the socket; ends a `packets` that waits, from any thread."""
        super().close()
        self._receiver.stop()
        if self._positions is not None:
            self._positions.close()

    def _await(self, table: TableSearch, wait_s: float) -> None:
        """Wait for the calibration table; what comes meanwhile is held. Without one the sensor is a generic one."""
        end = time.monotonic() + wait_s
        while not table.settled and (left_s := end - time.monotonic()) > 0.0:
            self._pump(min(left_s, TAKE_S))
        if table.sensor is None:
            self.sensor = find_calibration(None, None, table.first)

    def _pump(self, limit_s: float) -> None:
        """Hold what has come, waiting for it.

        Raises PacketError, SourceError.
        """
        payloads, stamps_ns, senders = self._receiver.take(BATCH_PACKETS, limit_s)
        came: list[Packet] = []
        locked = -1 if self._sender is None else self._sender
        for number, stamp_ns in enumerate(stamps_ns.tolist()):
            payload = payloads[number * PACKET_BYTES : (number + 1) * PACKET_BYTES]
            if senders[number] != locked:
                if not self._accept(senders[number], payload):
                    continue
                locked = -1 if self._sender is None else self._sender
            if self._table is not None and not self._table.push(payload):
                self._learn(self._table)
            came.append(Packet(payload, stamp_ns))
        if self._positions is not None:
            sender = None if self._sender is None else self._receiver.sender(self._sender)
            came = self._positions.among(came, sender, anybody=self._any)
        self._held.extend(came)
        self._count()
        if self._refused is not None and self._sender is None:
            raise self._refused
        if self._receiver.failure() and not self.closed:
            raise SourceError(f"{self.label}: {os.strerror(self._receiver.failure())}")

    def _accept(self, sender: int, payload: bytes) -> bool:
        """Whether to take a packet that is not from the sender locked on; locks on to the first HDL-64E."""
        address = self._receiver.sender(sender)
        if (self._wanted is not None and address != self._wanted) or (self._sender is not None and not self._any):
            self._strangers += 1
            return False
        if self._sender is None:
            try:
                identify(payload)
            except PacketError as error:
                self._other += 1
                if self._other >= REFUSED_PACKETS:
                    self._refused = error
                return False
            self._sender = sender
            if not self._any:
                self._receiver.only(sender)
            logger.info("%s: packets from %s", self.label, ip_address(address))
        return True

    def _learn(self, table: TableSearch) -> None:
        """The search is over; what was found late replaces the generic calibration."""
        self._table = None
        if table.sensor is not None:
            self.sensor = table.sensor.with_convention(self.sensor.convention)
            logger.info("%s: calibration %s from the sensor's status bytes", self.label, self.sensor.hash)

    def _count(self) -> None:
        kernel, queue, wrong, position, strangers = self._receiver.counts()
        beside = Counter[str]() if self._positions is None else self._positions.counts
        found = {
            "kernel drops": kernel + beside["kernel drops"],
            "queue drops": queue,
            "wrong length": wrong + beside["wrong length"],
            "position packets": beside["position packets"],
            UNKEPT_POSITIONS: position,
            "strangers": strangers + self._strangers + beside["strangers"],
            "other sensor": self._other,
        }
        self.counts.update({cause: count - self.counts[cause] for cause, count in found.items() if count})
