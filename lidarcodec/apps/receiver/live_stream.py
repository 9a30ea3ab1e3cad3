"""LiveStream: an iterator over decoded frames of a live stream, with UDP output and recording.

>>> from lidarcodec.transport.memory import MemoryNetwork
>>> with subscribe("vehicle/lidar", transport=MemoryNetwork().transport()) as live:
...     print(live.next(timeout_s=0.01), live.summary()["replaced"])
None 0
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import time
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any, Self

from lidarcodec.apps.clocks import SYSTEM, Clock
from lidarcodec.apps.mailbox import Mailbox
from lidarcodec.apps.receiver.freshness import Forward, Freshness, MaxAge
from lidarcodec.apps.receiver.receiver import Receiver
from lidarcodec.apps.receiver.stats import ReceiverStats
from lidarcodec.apps.receiver.udp_out import UdpOut
from lidarcodec.apps.recorder import BackgroundRecorder
from lidarcodec.apps.worker.isolation import Isolate
from lidarcodec.assembly.turns import TurnJoiner
from lidarcodec.errors import TransportError
from lidarcodec.frame import Frame
from lidarcodec.settings import valid_name
from lidarcodec.transport import Endpoints, Transport, certificates_of, party_of
from lidarcodec.transport.endpoints import Mode
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.transport.published import published

TICK_S = 0.2
LAST_PACKETS_S = 5.0
"""Time to send the remaining UDP packets when a stream ends: at most the packets of half a second."""


def receiver_name() -> str:
    """A name that no other receiver has: host, process, four random digits."""
    host = "".join(c if c.isascii() and c.isalnum() else "-" for c in socket.gethostname())[:32]
    return f"{host}-{os.getpid()}-{os.urandom(2).hex()}"


def subscribe(
    key: str = "lidarcodec/v1/vehicle/lidar",
    *,
    connect: str | list[str] | None = None,
    listen: str | list[str] | None = None,
    config: str | Path | None = None,
    mode: Mode | None = None,
    loopback_port: int | None = None,
    transport: Transport | None = None,
    receiver: str | None = None,
    newest: bool = True,
    timeout_s: float | None = None,
    max_age_s: MaxAge = "live",
    until_end: bool = False,
    udp: str | None = None,
    record: str | Path | None = None,
    clouds: bool = False,
    refine: bool = False,
    parts: bool = False,
    isolate: Isolate | None = None,
    clock: Clock = SYSTEM,
) -> LiveStream:
    """A live stream to iterate over: `with subscribe(...) as live: for frame in live: ...`

    connect, listen, config, mode, loopback_port: as in `Endpoints`; without them nothing leaves the machine
    others: as in `LiveStream`
    Raises SettingsError for an invalid key or name, TransportError for endpoints that cannot be used.
    """
    endpoints = Endpoints.of(connect, listen, config, mode, loopback_port)
    return LiveStream(
        key,
        endpoints=endpoints,
        transport=transport,
        receiver=receiver,
        newest=newest,
        timeout_s=timeout_s,
        max_age_s=max_age_s,
        until_end=until_end,
        udp=udp,
        record=record,
        clouds=clouds,
        refine=refine,
        parts=parts,
        isolate=isolate,
        clock=clock,
    )


class LiveStream:
    """Decoded frames of one stream. It continues after restarts of the publisher and the network. A context manager.

    key:        `lidarcodec/v1/VEHICLE/SENSOR`, or `VEHICLE/SENSOR`
    endpoints:  where to listen and connect; by default nothing leaves the machine
    transport:  an open transport to use instead
    receiver:   the name in arrival reports; by default the name in a configuration of `lidarcodec certs`, because only
                this name is allowed; otherwise a unique name
    newest:     True: a slow iteration gets the newest frame; replaced frames are counted. False: it gets every frame,
                which slows the publisher down
    timeout_s:  iteration ends after this time without a frame; None: never
    max_age_s:  a frame that is older than this when decoded is counted as stale and skipped; None: none is skipped.
                `live`: two seconds with `newest`, unless only old frames come; otherwise none is skipped
    until_end:  iteration ends when the publisher stops
    udp:        `HOST:PORT` to which the packets are sent, like the sensor's own stream. `?position=PORT` also sends
                position packets; by default they go to port 8308 if PORT is 2368, and to 7503 if it is 7502
    record:     folder for the messages;  clouds: also record the points of each frame, for viewers
    refine:     take refinements of a stream with `base_error_m`, and record them. A frame is given when it is refined
                whole, or else when the next message comes: up to a frame later
    parts:      with `framing=parts:N` give each part of a turn as soon as it is decoded. Otherwise a frame is a turn
    isolate:    which decoders run in a process of their own: `always`, `never`, or `auto` (those with native code that
                may crash). By default the variable LIDARCODEC_ISOLATE, otherwise `auto`
    on_message: called with the bytes of every message, in the receive thread; must be quick and raise nothing
    stats:      counts and times of this receiver;  status: the publisher's last status
    """

    def __init__(
        self,
        key: str,
        *,
        endpoints: Endpoints | None = None,
        transport: Transport | None = None,
        receiver: str | None = None,
        newest: bool = True,
        timeout_s: float | None = None,
        max_age_s: MaxAge = "live",
        until_end: bool = False,
        udp: str | None = None,
        record: str | Path | None = None,
        clouds: bool = False,
        refine: bool = False,
        parts: bool = False,
        isolate: Isolate | None = None,
        clock: Clock = SYSTEM,
        on_message: Callable[[bytes], object] | None = None,
    ) -> None:
        """Raises SettingsError for an invalid key, name or address, TransportError for an unknown UDP host."""
        keys = StreamKeys.parse(key)
        party, self._certificates = party_of(endpoints), certificates_of(endpoints)
        own = receiver_name() if party is None else party.name
        self.receiver = valid_name(own if receiver is None else receiver, "receiver")
        self._newest, self._timeout_s, self._clock = newest, timeout_s, clock
        self._fresh = Freshness.of(max_age_s, newest=newest)
        self._udp = None if udp is None else UdpOut(udp)
        self._recorder = None if record is None else BackgroundRecorder(Path(record), keys)
        self._clouds = clouds
        self._turns = None if parts else TurnJoiner()
        if clouds and self._recorder is not None:
            self._recorder.keep_clouds()
        self._on_message = on_message
        self._interrupted = self._begun = False
        self._forward = Forward()
        self._listeners: list[Callable[[], object]] = []
        self._frames: Mailbox[Frame] = Mailbox(self._notify)
        self._receiver = Receiver(
            keys,
            self.receiver,
            self._deliver,
            self._keep,
            self._ended,
            endpoints=endpoints,
            transport=transport,
            until_end=until_end,
            isolate=isolate,
            clock=clock,
            refine=refine,
        )

    # --- iteration --------------------------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        """Begin to receive. If the router is unreachable, it tries again in the background.

        Raises TransportError if the endpoints cannot be used, or the stream was open before.
        """
        if self._begun:
            raise TransportError("a live stream can be opened only once: call subscribe() again")
        self._begun = True
        for output in (self._udp, self._recorder):
            if output is not None:
                output.start()
        try:
            self._receiver.start()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def next(self, timeout_s: float | None = None) -> Frame | None:
        """The next frame; None after the timeout, the end or an interruption.

        Raises TransportError if the network failed or the stream is not open, otherwise the error that ended it.
        """
        self._check_begun()
        end = None if timeout_s is None else time.monotonic() + timeout_s
        while not self._interrupted:
            left = TICK_S if end is None else end - time.monotonic()
            frame = self._frames.take(max(0.0, min(left, TICK_S)))
            if frame is not None:
                return frame
            if self._frames.finished:
                self._raise_failure()
                return None
            if left <= 0:
                return None
        return None

    def __iter__(self) -> Iterator[Frame]:
        while (frame := self.next(self._timeout_s)) is not None:
            yield frame

    async def next_async(self, timeout_s: float | None = None) -> Frame | None:
        """As `next`, for asyncio. Cancelling the wait loses no frame."""
        self._check_begun()
        loop = asyncio.get_running_loop()
        end = None if timeout_s is None else loop.time() + timeout_s
        changed = asyncio.Event()

        def tell() -> None:
            loop.call_soon_threadsafe(changed.set)

        self._listeners.append(tell)
        try:
            while not self._interrupted:
                changed.clear()
                frame = self._frames.take(0.0)
                if frame is not None:
                    return frame
                if self._frames.finished:
                    self._raise_failure()
                    return None
                left = TICK_S if end is None else end - loop.time()
                if left <= 0:
                    return None
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(changed.wait(), min(left, TICK_S))
            return None
        finally:
            self._listeners.remove(tell)

    async def __aiter__(self) -> AsyncIterator[Frame]:
        while (frame := await self.next_async(self._timeout_s)) is not None:
            yield frame

    @property
    def stats(self) -> ReceiverStats:
        """Counts and times of this receiver."""
        return self._receiver.stats

    @property
    def status(self) -> dict[str, Any] | None:
        """The publisher's last status (docs/live.md lists the fields); None before the first."""
        return self._receiver.status

    @property
    def alive(self) -> bool:
        """Whether a publisher is online."""
        return self._receiver.alive

    def others(self) -> list[str]:
        """Streams that have a publisher where this one was looked for, as `VEHICLE/SENSOR`. It takes 0.3 s.

        Raises TransportError.
        """
        transport = self._receiver.transport
        return [] if transport is None else published(transport)

    @property
    def ended(self) -> bool:
        """Whether no more frames will come: the stream has ended, or was interrupted."""
        return self._interrupted or self._frames.finished

    @property
    def replaced(self) -> int:
        """Number of frames that a newer one replaced before the iteration took them."""
        return self._frames.replaced

    def summary(self) -> dict[str, Any]:
        """Counts and times as plain values, including those of the outputs."""
        return {
            **self.stats.summary(),
            "errors": dict(self._receiver.errors),
            "worker": self._receiver.worker,
            "worker_restarts": self._receiver.worker_restarts,
            "replaced": self.replaced,
            "refinements": None if (taken := self._receiver.refinements) is None else dict(taken.counts),
            "rtt_ms": self._receiver.rtt_ms,
            "udp": None if self._udp is None else dict(self._udp.counts),
            "recording": None if self._recorder is None else self._recorder.state(),
            "certificate": None if self._certificates is None else self._certificates.told(),
            "gate": self._receiver.gate(),
        }

    def interrupt(self) -> None:
        """Make the iteration end soon. Signal handlers may call this method only: it takes no lock."""
        self._interrupted = True

    def request_key(self) -> None:
        """Ask the publisher for a key frame."""
        self._receiver.request_key()

    def close(self) -> None:
        """End everything: threads, network, outputs. A second call does nothing."""
        self._frames.close()
        if self._udp is not None:
            self._udp.close()
        self._receiver.close()
        if self._recorder is not None:
            self._recorder.close()

    def _deliver(self, frame: Frame) -> None:
        """Forward what was decoded; called in the decode thread."""
        for whole in [frame] if self._turns is None else self._turns.add(frame):
            self._give(whole)

    def _give(self, frame: Frame) -> None:
        """Forward a frame to iteration and outputs."""
        latency_ms = self.stats.decoded(frame, self._clock.wall_ns())
        if self._clouds and self._recorder is not None:
            self._recorder.cloud(frame)
        if not self._fresh.shows(latency_ms, self._clock.monotonic_s()) or (self._newest and self._goes_back(frame)):
            self.stats.count("stale")
            return
        if self._newest:
            if self._udp is not None:
                self._udp.put(frame)
            self._frames.put(frame)
            return
        while self._udp is not None and not self._udp.put_wait(frame, TICK_S) and not self._frames.closed:
            pass
        while not self._frames.put_wait(frame, TICK_S) and not self._frames.closed:
            pass

    def _goes_back(self, frame: Frame) -> bool:
        """Whether a later frame of the same stream was shown before: networks may reorder messages."""
        message = self._receiver.decoded
        stream_id = None if message is None else message.stream_id
        return self._forward.goes_back(stream_id, frame.index, frame.stamp_ns, self._clock.monotonic_s())

    def _keep(self, data: bytes) -> None:
        if self._recorder is not None:
            self._recorder.message(data)
        if self._on_message is not None:
            self._on_message(data)

    def _ended(self) -> None:
        """No more messages will come: send the last UDP packets, then end the iteration."""
        try:
            for frame in [] if self._turns is None else self._turns.flush():
                self._give(frame)
            if self._udp is not None and not self._frames.closed:
                self._udp.wait_sent(LAST_PACKETS_S)
        finally:
            self._frames.close()

    def _notify(self) -> None:
        """Wake waiting coroutines."""
        for tell in tuple(self._listeners):
            with contextlib.suppress(RuntimeError):  # its loop is closed
                tell()

    def _check_begun(self) -> None:
        if not self._begun and not self._frames.closed:
            raise TransportError("this live stream is not open: write `with subscribe(...) as live:`")

    def _raise_failure(self) -> None:
        if self._receiver.failure is not None:
            raise self._receiver.failure
