"""UdpSource: the packets of a sensor that sends to this machine, live.

A native thread moves packets from the socket to a bounded queue without the interpreter, so that no packet is lost
while the program is busy for some seconds. Lost packets are counted: `kernel drops`, and `queue drops` (the oldest ones
of a full queue).
"""

from __future__ import annotations

import logging
import os
import time
from collections import Counter, deque
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from lidarcodec import _native
from lidarcodec.errors import CalibrationError, PacketError, SourceError
from lidarcodec.packet import FirstPacket, Packet
from lidarcodec.sensor_model import HDL64E, POINTCLOUD2, SensorModel
from lidarcodec.sensors import check_recognised, find_calibration, find_sensor
from lidarcodec.sensors.models.shapes import shapes
from lidarcodec.sensors.models.table import PACKETS, is_ouster
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.ouster_http import with_metadata
from lidarcodec.sources.spec import Spec, address_of
from lidarcodec.sources.table_search import TableSearch
from lidarcodec.sources.udp.assumed import sensor_before_packets
from lidarcodec.sources.udp.positions import listener_beside
from lidarcodec.sources.udp.senders import Senders, counts_of
from lidarcodec.sources.udp.socket import open_socket
from lidarcodec.sources.udp.watch import ModelWatch, NamedModel
from lidarcodec.sources.unit_calibration import warn_if_generic
from lidarcodec.units import DATA_PORT, PACKET_BYTES

logger = logging.getLogger(__name__)

QUEUE_PACKETS: Final = 16_384
"""Size of the queue: 4.7 s of an HDL-64 in single-return mode, 20 MB; at most 128 MiB of larger packets."""
BATCH_PACKETS: Final = 1024
TAKE_S: Final = 0.2
"""Longest wait in native code, so that an interrupt of the main thread is seen."""
LOOKED_AT: Final = 32
"""Packets of a sender by which the model of its sensor is recognised: 4 ms to 50 ms."""
LOOK_S: Final = 0.2
"""Time after which fewer are enough."""
SAY_S: Final = 5.0
"""Time without a first packet after which a warning is logged."""
WAIT_S: Final = 2.0
"""Longest wait for the calibration table: a little more than its 4160 packets (1.2 s)."""


class UdpSource(PacketSource):
    """Packets of one sensor at an address of this machine: of the sender whose packets are consistent with a sensor.

    A sender is an address and a port. It is chosen by the packets of the first 0.2 s. Another sender replaces it when
    it stops, or when its packets become inconsistent and those of the other are consistent; then a FirstPacket is
    given.
    The model of the sensor is recognised by the first packets of its sender, unless it is given.
    Counts: `kernel drops`, `queue drops`, `strangers` (packets of other senders), `sender changes`, `wrong length` (of
    no known sensor, or not of an HDL-64E), `position packets` (which are given), `position packets not kept` (sent to
    the data port).
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
        model: str | None = None,
    ) -> None:
        """Listens at once.

        src:        take packets of this sender only;  any_sender: take packets of all senders
        idle_s:     `packets` ends after this time without packets
        wait_s:     without a given calibration: how long to wait for the table in the sensor's status bytes (1.2 s);
                    one that comes later replaces `sensor` while packets are read
        position:   port of its position packets, 0 for none; by default as `POSITION_PORTS` says, none beside others
        model:      of the sensor, as in `--model`; by default the one that the packets show
        Raises SourceError if the address cannot be listened on, PacketError if what sends there is no known sensor,
        CalibrationError, UnknownNameError.
        """
        assumed = sensor_before_packets(calibration, model)
        super().__init__(assumed or find_calibration(None, None, ()), live=True)
        wanted = None if src is None else address_of(src)
        sock = open_socket(host, port, interface=interface, share=share)
        with sock:
            self.address: tuple[str, int] = sock.getsockname()[:2]
            pinned = b"" if wanted is None else wanted.packed
            self._positions = listener_beside(host, self.address[1], position, interface=interface, share=share)
            self._receiver = _native.UdpReceiver(
                sock.fileno(),
                QUEUE_PACKETS,
                pinned,
                any_sender,
                list(shapes(None if model == PACKETS else model)),  # evidence of a sensor
                model == PACKETS,
                model in (None, HDL64E, PACKETS),
            )  # a copy of the socket
        self.label = f"UDP {self.address[0]} port {self.address[1]}"
        self._idle_s, self._any = idle_s, any_sender
        self._senders = Senders(self.label, str(wanted or ""), any_sender)
        self._look_s = 0.0
        self._sender = 0
        self._known: tuple[int, bytes | None] = (0, None)
        self._searches = calibration is None
        self._calibration, self._model = calibration, model
        self._now = self._given = self.sensor
        """The sensor of the packets that come in now, and of those given last."""
        self._first: list[bytes] | None = None if model in (HDL64E, PACKETS) else []
        """First packets of the sender, until the model of its sensor is known."""
        self._named = None if model in (None, PACKETS) else NamedModel(str(model), self.label)
        self._settled = False
        """Whether a sensor was found once: from then on no packets of another one end the source."""
        self._watch: ModelWatch | None = None
        """Of the sensor that was recognised; None where no other can take its place."""
        self._unknown: list[Packet] = []
        """Packets that wait for that."""
        self._changed = False
        self._first_s = 0.0
        self._wrong = 0
        self._opened = False
        self._last_ns: int | None = None
        self._held: deque[tuple[Packet, SensorModel]] = deque()
        self._table = TableSearch() if calibration is None and model in (None, HDL64E) else None
        try:
            self._await(wait_s if calibration is None or assumed is None else 0.0)
        except BaseException:
            self.close()
            raise
        self.sensor = self._given = self._now
        self.silent = self._first is not None and not self._unknown and not self._held
        """Whether nothing came so far: which sensor it is, and with which calibration, is not known yet."""
        self._opened = True

    @classmethod
    def from_spec(cls, spec: Spec, calibration: Path | None) -> UdpSource:
        """The source for `udp://HOST:PORT?src=&any=&idle=&wait=&interface=&share=&position=&model=`."""
        spec.only("src", "any", "idle", "wait", "interface", "share", "position", "model")
        if spec.model() == POINTCLOUD2:
            raise SourceError(f"{spec.text}: point clouds cannot come over UDP: read a bag, or ros2:/TOPIC live")
        host, port = spec.host_and_port()
        return cls(
            host,
            DATA_PORT if port is None else port,
            calibration,
            src=spec.options.get("src"),
            any_sender=spec.flag("any"),
            idle_s=spec.number("idle", 0.001, 1e9),
            wait_s=WAIT_S if (wait_s := spec.number("wait", 0.0, 60.0)) is None else wait_s,
            interface=spec.options.get("interface"),
            share=spec.flag("share"),
            position=spec.position_port(),
            model=spec.model(),
        )

    def packets(self) -> Iterator[Packet]:
        """Packets as they come, each once, with the kernel's time of arrival; ends when `close` is called, when none
        came for `idle_s`, or behind those that had come when `finish` was called. `sensor` is that of the packet given
        last. Cost: 5 us a packet.

        Raises PacketError if what sends here is no known sensor, SourceError if the socket fails.
        """
        heard, told = time.monotonic(), False
        while not self.closed:
            if not self._held:
                self._pump(TAKE_S if self._idle_s is None else min(TAKE_S, self._idle_s))
            if self._held:
                while self._held and not self.closed:
                    packet, sensor = self._held.popleft()
                    if self._last_ns is not None and packet.stamp_ns > self._last_ns:
                        return
                    if sensor is not self._given or self.silent or isinstance(packet, FirstPacket):
                        self._give(sensor)
                    yield packet
                heard, told = time.monotonic(), True
            elif self._receiver.holding():
                heard = time.monotonic()
            elif self._unknown:
                waited_s = time.monotonic() - self._first_s
                if self._last_ns is not None or waited_s >= min(LOOK_S, self._idle_s or LOOK_S):
                    self._pump(0.0, settle=True)
            elif self._last_ns is not None:
                return
            elif self._idle_s is not None and time.monotonic() - heard >= self._idle_s:
                logger.info("%s: nothing came for %g s", self.label, self._idle_s)
                return
            elif not told and time.monotonic() - heard >= SAY_S:
                told = True
                self._say_silent()

    def finish(self) -> None:
        """End `packets` after the packets received so far. Does not wait, so a signal handler may call it."""
        self._last_ns = time.time_ns()

    def close(self) -> None:
        """Close the socket; ends a `packets` that waits, from any thread."""
        super().close()
        self._receiver.stop()
        self._count()
        self._senders.close()
        if self._positions is not None:
            self._positions.close()

    def _say_silent(self) -> None:
        limit_s = self._idle_s
        until = "until Ctrl-C (?idle=60 gives up after 60 s)" if limit_s is None else f"for up to {limit_s:g} s"
        logger.warning("%s: no packet arrived within %g s; waiting %s", self.label, SAY_S, until)

    def _await(self, wait_s: float) -> None:
        """Wait for the model and the calibration table, and hold packets meanwhile."""
        end = time.monotonic() + wait_s
        while self._waits() and (left_s := end - time.monotonic()) > 0.0:
            self._pump(min(left_s, TAKE_S))
        if self._table is not None and self._table.sensor is None and self._now.is_hdl64e and self._searches:
            self._now = find_calibration(None, None, self._table.first)

    def _waits(self) -> bool:
        table = self._table
        return self._first is not None or (table is not None and not table.settled)

    def _pump(self, limit_s: float, *, settle: bool = False) -> None:
        """Wait for packets, at most `limit_s`, and hold them. settle: recognise the sensor by what came so far

        Raises PacketError, SourceError, CalibrationError.
        """
        payloads, sizes, stamps_ns, senders = self._receiver.take(BATCH_PACKETS, limit_s)
        came: list[Packet] = []
        at = 0
        for size, stamp_ns, sender in zip(sizes.tolist(), stamps_ns.tolist(), senders.tolist(), strict=True):
            payload, before = payloads[at : (at := at + size)], self._now
            kind = Packet
            if sender != self._sender:
                if self._sender and not self._any:
                    kind = FirstPacket
                    self._unknown = self._drop_unknown()
                    self._forget()
                self._sender = sender
            if self._named is not None:
                self._named.push(payload)
            if self._first is None and self._watch is not None and self._watch.push(payload):
                self._first = []
            if self._first is not None:
                self._look_at(payload)
            if self._table is not None and size == PACKET_BYTES and not self._table.push(payload):
                self._learn(self._table)
            if self._now is not before:
                self._hold(came, before)
                came = []
            self._unknown.append(kind(payload, stamp_ns))
            if self._first is None:
                came += self._of_known_size()
        before = self._now
        if self._first and (settle or time.monotonic() - self._first_s >= LOOK_S):
            self._recognise(self._first)
            self._hold(came, before)
            came = self._of_known_size()
        if came or not self._unknown:
            self._hold(came, self._now)
        if (now_s := time.monotonic()) - self._look_s >= TAKE_S:
            self._look_s = now_s
            self._count()
        if self._receiver.failure() and not self.closed:
            raise SourceError(f"{self.label}: {os.strerror(self._receiver.failure())}")

    def _hold(self, came: list[Packet], sensor: SensorModel) -> None:
        """Hold packets of a sensor, with the position packets among them."""
        if self._positions is not None:
            came = self._positions.among(came, self._address_of(self._sender), anybody=self._any)
        self._held.extend((packet, sensor) for packet in came)

    def _of_known_size(self) -> list[Packet]:
        """The packets that waited, now that their sensor is known; those that an HDL-64E does not send are counted."""
        waited, self._unknown = self._unknown, []
        if not self._now.is_hdl64e:
            return waited
        right = [packet for packet in waited if len(packet.payload) == PACKET_BYTES]
        self._wrong += len(waited) - len(right)
        return right

    def _drop_unknown(self) -> list[Packet]:
        """Count the packets of a sender that gave way before its sensor was known."""
        self._wrong += len(self._unknown)
        return []

    def _give(self, sensor: SensorModel) -> None:
        """Packets of another sensor, or with another calibration, follow."""
        before, self._given, self.silent = self._given, sensor, False
        self.sensor = sensor.with_convention(self.sensor.convention)
        if before.model != sensor.model:
            logger.warning("%s: the packets are now those of a %s, and are read as such", self.label, sensor.name)
        warn_if_generic(self.sensor, f"{self.label}, sender {self._sender}", live=True)

    def _look_at(self, payload: bytes) -> None:
        """Keep one of the sender's first packets, and recognise its sensor when there are enough."""
        assert self._first is not None
        if not self._first:
            self._first_s = time.monotonic()
        self._first.append(payload)
        if len(self._first) >= LOOKED_AT:
            self._recognise(self._first)

    def _recognise(self, first: list[bytes]) -> None:
        """Take the sensor that these packets are of.

        Raises PacketError if it is no known one, CalibrationError if the given calibration is of another.
        """
        self._first, before = None, self._now
        try:
            found = check_recognised(first) if self._model is None else None
        except PacketError:
            if self._watch is None:
                raise
            self._watch.found_the_same()  # of no sensor that is known: they travel as odd packets of this one
            return
        if found is not None:
            logger.info("%s: %s", self.label, found.evidence)
        self._now = self._sensor_of(str(self._model if found is None else found.model), first)
        self._settled = True
        if self._model is not None or self._any:
            return
        if self._watch is None:
            self._watch = ModelWatch(self._now)
        elif self._now is before:
            self._watch.found_the_same()
        else:
            self._watch.watch(self._now)

    def _sensor_of(self, model: str, first: list[bytes]) -> SensorModel:
        """The sensor of that model; without the given calibration if that is of the sensor before.

        Raises CalibrationError for the first sensor if that calibration is of another.
        """
        try:
            return self._calibrated(model, first, self._calibration)
        except CalibrationError as error:
            if not self._settled:
                raise
            logger.warning(
                "%s: these are packets of another sensor, so the given calibration is not used: %s", self.label, error
            )
            return self._calibrated(model, first, None)

    def _calibrated(self, model: str, first: list[bytes], calibration: Path | None) -> SensorModel:
        """The sensor of that model, with its calibration; the one there is if it is the same."""
        if model == HDL64E:
            if self._changed or not self._now.is_hdl64e:
                return find_calibration(None, calibration, first if self._opened else ())
            return self._now
        self._table = None
        sensor = find_sensor(None, calibration, first, model)
        if is_ouster(sensor.model) and not sensor.description:
            sensor = with_metadata(sensor, self._address_of(self._sender), self.label)
        same = (sensor.hash, sensor.origin) == (self._now.hash, self._now.origin)
        return self._now if same else sensor

    def _forget(self) -> None:
        """The sender changed: forget the calibration, model and time of the previous one."""
        self._changed = True
        if self._model is None:
            self._first = []
        if self._searches and self._model in (None, HDL64E):
            self._table = TableSearch()
        if self._searches and self._model == HDL64E:
            self._now = find_calibration(None, None, ())

    def _learn(self, table: TableSearch) -> None:
        """The search is over; a table that was found replaces the generic calibration."""
        self._table = None
        if table.sensor is not None and self._now.is_hdl64e:
            self._now = table.sensor
            text = "%s: from now on the calibration %s from the sensor's status bytes is used"
            logger.log(logging.WARNING if self._opened else logging.INFO, text, self.label, table.sensor.hash)

    def _address_of(self, sender: int) -> bytes | None:
        """Address of the sender with that id; None before its first packet."""
        if sender != self._known[0]:
            found = {number: where[0] for number, where, *_ in self._receiver.senders().report()}
            self._known = sender, found.get(sender, self._known[1])
        return self._known[1] if sender else None

    def _count(self) -> None:
        judge = self._receiver.senders()
        beside = Counter[str]() if self._positions is None else self._positions.counts
        found = counts_of(self._receiver, self._wrong, beside)
        for cause, count in found.items():  # set, not added: `close` may do this in another thread at the same time
            if count:
                self.counts[cause] = count
        self._senders.look(judge, self.counts)
        if self._positions is not None:
            self._senders.refused_positions(beside["strangers"], self._positions.stranger)
