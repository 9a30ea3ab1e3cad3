"""UdpOut: sends decoded frames like the sensor's own UDP stream, for unchanged drivers and viewers.

Packets have the same intervals as on the vehicle. A frame arrives as a whole, so its first packet leaves DELAY_S
after the arrival time of the slowest recent frame, and its last packet a turn later. When the path gets faster again,
packets are sent a little faster. A frame that arrives while two frames wait replaces the older one.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import socket
import sys
import threading
import time
from collections import Counter, deque
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.apps.once import Once
from lidarcodec.assembly import packets_of
from lidarcodec.errors import LidarCodecError, SettingsError, TransportError
from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.packet_rest import PacketRest
from lidarcodec.side import SideInfo
from lidarcodec.units import DATA_PORT, POSITION_PORTS, is_number

logger = logging.getLogger(__name__)

WAITING: Final = 2
"""Most frames that wait while one is being sent."""
DELAY_S: Final = 0.02
CATCH_UP: Final = 1.25
"""Speed of sending while frames wait longer than necessary, relative to the sensor."""
REMEMBERED: Final = 20
"""Number of newest frames, two seconds, whose largest delay determines the time of sending."""
NAP_S: Final = 0.0005
"""Packets due within this time leave together."""
LATE_S: Final = 0.5
"""A frame that is this much too late or too early follows a clock jump or begins a new stream: timing is reset."""
SEND_BUFFER: Final = 1 << 20
_REPORTS: Final = {socket.AF_INET: (socket.IPPROTO_IP, 11), socket.AF_INET6: (socket.IPPROTO_IPV6, 25)}
"""IP_RECVERR and IPV6_RECVERR of Linux: the next call says what an ICMP message said of an earlier packet."""
_REPORTED: Final = {errno.ECONNREFUSED, errno.EHOSTUNREACH}


def address_of(text: str) -> tuple[socket.AddressFamily, tuple[str, int]]:
    """Family and address of `HOST`, `HOST:PORT` or `[HOST]:PORT`. The default port is 2368.

    Raises SettingsError for any other text, TransportError for an unknown host.
    """
    host, colon, port = text.rpartition(":") if not text.endswith("]") else (text, "", "")
    if not colon:
        host, port = text, str(DATA_PORT)
    if not host or not is_number(port, 65535, 1) or (":" in host and host[0] != "["):
        raise SettingsError(f"'{text}' is not a UDP address: write HOST:PORT or [HOST]:PORT", "udp")
    try:
        found = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_DGRAM)[0]
    except (OSError, UnicodeError) as error:
        raise TransportError(f"unknown host in '{text}': {error}") from None
    return found[0], (str(found[4][0]), int(found[4][1]))


class Target(NamedTuple):
    """The address for data packets, and the port for position packets (None: they are not sent)."""

    family: socket.AddressFamily
    data: tuple[str, int]
    position: tuple[str, int] | None


def target_of(text: str) -> Target:
    """The target of `HOST:PORT`, `HOST:PORT?position=PORT` or `HOST:PORT?position=off`. Without `position` a usual data
    port has its usual position port (`POSITION_PORTS`), and others have none.

    Raises SettingsError for any other text, TransportError for an unknown host.
    """
    place, question, options = text.partition("?")
    family, data = address_of(place)
    name, _, port = options.partition("=")
    if not question:
        beside = POSITION_PORTS.get(data[1])
        return Target(family, data, None if beside is None else (data[0], beside))
    if name != "position" or (port != "off" and not is_number(port, 65535, 1)):
        raise SettingsError(f"cannot read '{text}': write HOST:PORT?position=PORT or HOST:PORT?position=off", "udp")
    return Target(family, data, None if port == "off" else (data[0], int(port)))


def due_s(side: SideInfo | PacketRest) -> npt.NDArray[np.float64]:
    """(N,) float64, send time of each packet in seconds after the frame's first data packet, in the order of
    `packets_of`. A position packet is sent between its neighbours; its own time does not matter."""
    data = np.clip(np.maximum.accumulate(side.packet_ns), 0, 10**9).tolist()
    due = list(data)
    for one in reversed(side.positions):
        before = data[one.place - 1] if one.place else 0
        after = data[one.place] if one.place < len(data) else before
        due.insert(one.place, min(max(one.offset_ns, before), after))
    return np.array(due, np.float64) / 1e9


class UdpOut:
    """Sends the packets of frames to one address, in a thread of its own.

    counts: `frames`, `packets`, `position packets`, `replaced` (frames that came too fast), `late` (resets of the
            timing), `send errors`, `refused` (packets that the far end did not take, as far as it said so),
            `no packets` (frames that lack data for packets), `position packets not sent` (there is no port for them)
    """

    def __init__(self, address: str) -> None:
        """Raises SettingsError or TransportError if the address cannot be used."""
        self._target = target_of(address)
        family = self._target.family
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        if sys.platform == "linux":
            with contextlib.suppress(OSError):
                self._socket.setsockopt(*_REPORTS[family], 1)
        if family == socket.AF_INET:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)  # sensors broadcast by default
        self._queue: deque[tuple[Frame, float | None]] = deque()
        self._needs: deque[float] = deque(maxlen=REMEMBERED)
        self._idle = True
        self._condition = threading.Condition()
        self._closed = threading.Event()
        self._once = Once(logger)
        self.counts: Counter[str] = self._once.counts
        self._offset: float | None = None
        self._thread = threading.Thread(target=self._run, name="lidarcodec udp out", daemon=True)

    def start(self) -> None:
        """Begin to send."""
        self._thread.start()

    def put(self, frame: Frame) -> None:
        """Send a frame's packets when they are due. If too many frames wait, the oldest is dropped."""
        with self._condition:
            if len(self._queue) >= WAITING:
                self._queue.popleft()
                self.counts["replaced"] += 1
            self._queue.append((frame, time.monotonic()))
            self._condition.notify_all()

    def put_wait(self, frame: Frame, timeout_s: float) -> bool:
        """The same, but wait for room instead of dropping a frame; False after the timeout."""
        with self._condition:
            free = self._condition.wait_for(lambda: len(self._queue) < WAITING or self._closed.is_set(), timeout_s)
            if not free or self._closed.is_set():
                return False
            self._queue.append((frame, None))
            self._condition.notify_all()
            return True

    def wait_sent(self, timeout_s: float) -> bool:
        """Wait until everything was sent, at most `timeout_s` or until closed. Returns whether everything was sent."""

        def sent() -> bool:
            return not self._queue and self._idle

        with self._condition:
            self._condition.wait_for(lambda: sent() or self._closed.is_set(), timeout_s)
            return sent()

    def close(self) -> None:
        """End at once, even within a frame. A second call does nothing."""
        self._closed.set()
        with self._condition:
            self._condition.notify_all()
        if self._thread.is_alive():
            self._thread.join(2.0)
        self._socket.close()

    def _run(self) -> None:
        while not self._closed.is_set():
            with self._condition:
                self._idle = True
                self._condition.notify_all()
                self._condition.wait_for(lambda: bool(self._queue) or self._closed.is_set())
                if not self._queue:
                    continue
                frame, arrival_s = self._queue.popleft()
                self._idle = False
                self._condition.notify_all()
            try:
                self._send(frame, packets_of(frame), arrival_s)
            except LidarCodecError as error:
                self._once.add("no packets", error)

    def _send(self, frame: Frame, packets: list[Packet], arrival_s: float | None) -> None:
        """Send the packets of a frame, each when it is due."""
        if frame.side is None or not packets:
            return
        if frame.sensor.is_cloud:
            self._once.add(
                "no packets",
                SettingsError(
                    "this stream has point clouds, which cannot be sent as "
                    "packets over UDP: use `bridge ros2` or --record"
                ),
            )
            return
        steps = due_s(frame.side)
        begin, excess = self._begin(frame.stamp_ns / 1e9, arrival_s)
        gained = np.minimum(steps * (1 - 1 / CATCH_UP), excess)
        for packet, due in zip(packets, (begin + steps - gained).tolist(), strict=True):
            ahead = due - time.monotonic()
            if ahead > NAP_S and self._closed.wait(ahead):
                return
            address = self._target.position if packet.position else self._target.data
            if address is None:
                self._once.add(
                    "position packets not sent", SettingsError("give their port with --udp HOST:PORT?position=PORT")
                )
                continue
            try:
                self._give(packet.payload, address)
            except OSError as error:
                self._once.add("send errors", error)
                continue
            self.counts["position packets" if packet.position else "packets"] += 1
        self.counts["frames"] += 1
        if self._offset is not None:
            self._offset -= float(gained[-1])

    def _give(self, payload: bytes, address: tuple[str, int]) -> None:
        """Send a packet; again, if the first call said what became of an earlier one."""
        try:
            self._socket.sendto(payload, address)
        except OSError as error:
            if error.errno not in _REPORTED:
                raise
            host, port = self._target.data
            self._once.add("refused", TransportError(f"nobody takes packets at {host}, port {port}: {error.strerror}"))
            self._socket.sendto(payload, address)

    def _begin(self, stamp_s: float, arrival_s: float | None) -> tuple[float, float]:
        """Monotonic time at which to begin sending a frame with this stamp, and the time in seconds that the next
        frames can catch up. It depends on the slowest recent frame."""
        now = time.monotonic()
        if arrival_s is not None:
            self._needs.append(arrival_s - stamp_s)
        if self._offset is not None and not now - LATE_S < stamp_s + self._offset < now + LATE_S:
            self.counts["late"] += 1
            self._offset = None
            self._needs.clear()
        if self._offset is None:
            self._offset = now - stamp_s + DELAY_S
        begin = max(stamp_s + self._offset, now)
        self._offset = begin - stamp_s
        needed = max(self._needs) + DELAY_S if self._needs else self._offset
        return begin, max(0.0, self._offset - needed)
