"""UdpSource: the packets of a sensor that sends to this machine, live.

A thread of its own drains the socket into a bounded queue, so that a busy consumer loses nothing for seconds. What is
lost all the same is counted: by the kernel (`kernel drops`), or where the queue was full (`queue drops`, oldest first).
"""

from __future__ import annotations

import logging
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from lidarcodec.errors import LidarCodecError, PacketError, SourceError
from lidarcodec.packet import Packet
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors import StatusReader, find_calibration, identify
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.capture import POSITION_BYTES
from lidarcodec.sources.spec import Spec, address_of
from lidarcodec.sources.udp_socket import open_socket, receive
from lidarcodec.units import DATA_PORT, PACKET_BYTES

logger = logging.getLogger(__name__)

QUEUE_PACKETS: Final = 16_384
"""4.7 s of an HDL-64 in single return, 20 MB."""
NAP_S: Final = 0.001
"""Pause after the socket was emptied: packets are handed over by threes and fours, with the kernel's own stamps."""
JITTER_NS: Final = 20_000_000
"""Until its time stamps run, the kernel stamps packets when they are read: later than those that arrive behind them."""
REFUSED_PACKETS: Final = 64
"""So many packets of another sensor, and none of an HDL-64E, end the source."""
WAIT_S: Final = 2.0
"""A little more than the 1.2 s (4160 packets) in which the table comes round."""
FIRST_PACKETS: Final = 64
PARAMETER_TYPES: Final = frozenset(b"1234567")
"""Status types that carry the calibration table: seven in sixteen packets. Without one among 64 there is no table."""
SEARCHED_PACKETS: Final = 5 * 4160


class TableSearch:
    """Looks for the calibration table in the first packets of a stream.

    first: the first payloads;  settled: set when there is nothing to wait for any more;  sensor: what was found
    """

    def __init__(self) -> None:
        self._reader = StatusReader()
        self._seen = 0
        self.first: list[bytes] = []
        self.settled = threading.Event()
        self.sensor: SensorModel | None = None

    def push(self, payload: bytes) -> bool:
        """Take the next packet; False when the search is over."""
        self._seen += 1
        if self._seen <= FIRST_PACKETS:
            self.first.append(payload)
            if self._seen == FIRST_PACKETS and not any(p[-2] in PARAMETER_TYPES for p in self.first):
                self.settled.set()
        if self._reader.push(payload):
            self.sensor = self._reader.sensor
            self.settled.set()
        return self.sensor is None and self._seen < SEARCHED_PACKETS


class UdpSource(PacketSource):
    """Packets of one sensor at an address of this machine; the first HDL-64E that sends is the one.

    Counts: `kernel drops`, `queue drops`, `strangers` (packets of other senders), `wrong length`, `position packets`,
    `other sensor`.
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
    ) -> None:
        """Listens at once.

        src:        take packets of this sender only;  any_sender: take those of all
        idle_s:     `packets` ends when none came for so long
        wait_s:     without a given calibration: how long to wait for the table in the sensor's status bytes (1.2 s)
        Raises SourceError if the address cannot be listened on, CalibrationError.
        """
        super().__init__(find_calibration(None, calibration, ()), live=True)
        self._wanted = None if src is None else address_of(src)
        self._socket = open_socket(host, port, interface=interface, share=share)
        self.address = self._socket.getsockname()[:2]
        self.label = f"UDP {self.address[0]} port {self.address[1]}"
        self._idle_s, self._any = idle_s, any_sender
        self._sender: str | None = None
        self._last_ns = 0
        self._queue: deque[Packet] = deque()
        self._arrived = threading.Event()
        self._failure: LidarCodecError | None = None
        self._lock = threading.Lock()
        self._table = table = TableSearch() if calibration is None else None
        self._wake, self._woken = socket.socketpair()
        self._thread = threading.Thread(target=self._run, name=f"lidarcodec udp {port}", daemon=True)
        self._thread.start()
        if table is not None:
            table.settled.wait(wait_s)
            generic = find_calibration(None, None, table.first)
            with self._lock:
                self.sensor = table.sensor or generic

    @classmethod
    def from_spec(cls, spec: Spec, calibration: Path | None) -> UdpSource:
        """The source that `udp://HOST:PORT?src=&any=&idle=&wait=&interface=&share=` names."""
        spec.only("src", "any", "idle", "wait", "interface", "share")
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
        )

    def packets(self) -> Iterator[Packet]:
        """Packets as they come, each once, with the kernel's time of arrival; ends when `close` is called, or when none
        came for `idle_s`.

        Raises PacketError if another sensor sends here and no HDL-64E, SourceError if the socket fails.
        """
        heard = time.monotonic()
        while not self.closed:
            try:
                packet = self._queue.popleft()
            except IndexError:
                self._arrived.clear()
                if self._queue:
                    continue
                if self._failure is not None:
                    raise self._failure from None
                left_s = None if self._idle_s is None else heard + self._idle_s - time.monotonic()
                if left_s is not None and left_s <= 0.0:
                    logger.info("%s: nothing for %g s", self.label, self._idle_s)
                    return
                if not self.closed:
                    self._arrived.wait(left_s)
                continue
            if self._idle_s is not None:
                heard = time.monotonic()
            yield packet

    def close(self) -> None:
        """Close the socket; ends a `packets` that waits, from any thread."""
        if self.closed:
            return
        super().close()
        self._wake.send(b"x")
        self._arrived.set()
        self._thread.join()
        self._wake.close()
        self._woken.close()

    def _run(self) -> None:
        """The receiving thread: socket -> queue, until `close`."""
        try:
            with selectors.DefaultSelector() as selector:
                selector.register(self._socket, selectors.EVENT_READ)
                selector.register(self._woken, selectors.EVENT_READ)
                while not self.closed and self._failure is None:
                    selector.select()
                    self._drain()
                    self._arrived.set()
                    time.sleep(NAP_S)
        except OSError as error:
            self._failure = SourceError(f"{self.label}: {error.strerror or error}")
        finally:
            self._arrived.set()
            self._socket.close()

    def _drain(self) -> None:
        """Take what the kernel holds; no more than a queue full, so that `close` is seen under any load."""
        drops, counts, queue, last_ns = 0, self.counts, self._queue, self._last_ns
        for _ in range(QUEUE_PACKETS):
            try:
                data, stamp_ns, dropped, sender = receive(self._socket)
            except BlockingIOError:
                break
            drops = dropped or drops
            if len(data) != PACKET_BYTES:
                counts["position packets" if len(data) == POSITION_BYTES else "wrong length"] += 1
            elif sender == self._sender or self._accept(sender, data):
                if self._table is not None:
                    self._learn(self._table, data)
                if len(queue) >= QUEUE_PACKETS:
                    queue.popleft()
                    counts["queue drops"] += 1
                if stamp_ns is None:
                    stamp_ns = time.time_ns()
                if 0 < last_ns - stamp_ns < JITTER_NS:
                    stamp_ns = last_ns
                last_ns = stamp_ns
                queue.append(Packet(data, stamp_ns))
        self._last_ns = last_ns
        if drops:
            counts["kernel drops"] = drops

    def _accept(self, sender: str, payload: bytes) -> bool:
        """Whether to take a packet that is not from the sender locked on; locks on to the first HDL-64E."""
        strange = self._wanted is not None and address_of(plain(sender)) != self._wanted
        if strange or (self._sender is not None and not self._any):
            self.counts["strangers"] += 1
            return False
        if self._sender is None:
            try:
                identify(payload)
            except PacketError as error:
                self.counts["other sensor"] += 1
                if self.counts["other sensor"] >= REFUSED_PACKETS:
                    self._failure = error
                return False
            self._sender = sender
            logger.info("%s: packets from %s", self.label, plain(sender))
        return True

    def _learn(self, table: TableSearch, payload: bytes) -> None:
        """Search for the calibration table; what is found late replaces the generic one."""
        if table.push(payload):
            return
        self._table = None
        if table.sensor is not None:
            with self._lock:
                self.sensor = table.sensor.with_convention(self.sensor.convention)
            logger.info("%s: calibration %s from the sensor's status bytes", self.label, self.sensor.hash)


def plain(sender: str) -> str:
    """An address without scope, and without the IPv6 form of an IPv4 one."""
    address = sender.partition("%")[0]
    return address[7:] if address.startswith("::ffff:") and "." in address else address
