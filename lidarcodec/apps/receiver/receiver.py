"""Receiver: messages of one stream in, decoded frames out. It continues after restarts of either side.

    receive thread   newest message, or parts of a turn -> header -> slot of the decoder -> arrival report
    decode thread    bytes -> message -> frames -> the given handler
    control thread   asks for key frames when one is needed, reports once a second, measures the round trip

The arrival report is sent before decoding, but only after the previous message has left the slot. So a slow decoder
delays reports, the publisher replaces frames before they are encoded, and no reference is lost.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from lidarcodec.apps.clocks import SYSTEM, Clock
from lidarcodec.apps.mailbox import Mailbox
from lidarcodec.apps.once import Once
from lidarcodec.apps.receiver.refinements import Refinements
from lidarcodec.apps.receiver.round_trips import RoundTrips
from lidarcodec.apps.receiver.stats import ReceiverStats
from lidarcodec.apps.receiver.turn_inbox import DEPTH, TurnInbox
from lidarcodec.apps.reports import Arrival, pack_arrival, read_status
from lidarcodec.apps.worker.isolation import Isolate, Isolation
from lidarcodec.codecs import table
from lidarcodec.errors import (
    DecodeError,
    LidarCodecError,
    MissingReferenceError,
    TransportError,
    UnsupportedVersionError,
    WorkerError,
    told,
)
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.pipeline import StreamDecoder
from lidarcodec.transport import Endpoints, Transport, open_transport
from lidarcodec.transport.base import Closeable, Inbox, Priority, Sender
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.untrusted.json import JsonRefusedError
from lidarcodec.wire import checksum_of, unpack

logger = logging.getLogger(__name__)

TICK_S = 0.2
KEY_INTERVAL_S = 0.5
"""Shortest interval between two requests for key frames."""
REPORT_S = 1.0
ASK_S = 1.0
START_S = 1.0
JOIN_S = 10.0


class Receiver:
    """One receiver of one stream.

    on_frame:   called with every decoded frame, in the decode thread; the next frame waits for it
    on_message: called with the bytes of every message, in the receive thread; must be quick
    on_end:     called when no more messages will come
    until_end:  end when the publisher has left
    isolate:    which decoders run in a process of their own, as in `LiveStream`;  clock: the clocks of this machine
    failure:    the error that ended it, or None;  transport: its session, or None before that is open
    refine:     whether to take refinements. A frame is then given when it is refined whole, or the next message comes
    decoding:   whether to decode messages; may change at any time. If not, messages are only counted, reported as
                arrived and passed to on_message, and only `request_key` asks for key frames
    decoded:    the message of the frames that on_frame gets
    stats:      counts and times;  status: the publisher's last status;  alive: whether a publisher is online
    """

    def __init__(
        self,
        keys: StreamKeys,
        name: str,
        on_frame: Callable[[Frame], object],
        on_message: Callable[[bytes], object],
        on_end: Callable[[], object],
        *,
        endpoints: Endpoints | None = None,
        transport: Transport | None = None,
        until_end: bool = False,
        isolate: Isolate | None = None,
        clock: Clock = SYSTEM,
        decoding: bool = True,
        refine: bool = False,
    ) -> None:
        """Raises SettingsError for an unknown choice of `isolate`."""
        self.keys, self.name = keys, name
        self.decoding = decoding
        self.decoded: Message | None = None
        self.stats = ReceiverStats(clock)
        self.stats.clocks.unsure = self._ask_time
        self._clock, self._round_trips = clock, RoundTrips(clock, self.stats.clocks)
        self.status: dict[str, Any] | None = None
        self.alive = False
        self.failure: Exception | None = None
        self._on_frame, self._on_message, self._on_end, self._until_end = on_frame, on_message, on_end, until_end
        self._endpoints, self.transport, self._own_transport = endpoints, transport, transport is None
        self._declared: list[Closeable] = []
        self._slot: Mailbox[Message] = Mailbox(goes_on=lambda message: message.goes_on)
        self._once = Once(logger)
        self.refinements = Refinements(keys, name, on_frame, on_message, self._once) if refine else None
        self._isolation = Isolation(isolate, lambda error: self._once.add(f"worker {error.cause}", error))
        self._decoder = self._fresh_decoder()
        self._stop, self._opened, self._poke = threading.Event(), threading.Event(), threading.Event()
        self._joined: int | None = None
        self._key_wanted, self._key_asked_for = True, False
        self._threads = [
            threading.Thread(target=run, name=f"lidarcodec {run.__name__.strip('_')}", daemon=True)
            for run in (self._receive, self._decode, self._control)
        ]

    @property
    def errors(self) -> Counter[str]:
        """Number of errors by cause."""
        return Counter(dict(self._once.counts))

    @property
    def rtt_ms(self) -> float | None:
        """Shortest of the last round trips to the publisher."""
        return self._round_trips.rtt_ms

    def start(self) -> None:
        """Begin to receive. If the router is unreachable, it tries again.

        Raises TransportError if the endpoints cannot be used.
        """
        for thread in self._threads:
            thread.start()
        self._opened.wait(START_S)
        if self.failure is not None:
            self.close()
            raise self.failure

    @property
    def worker(self) -> dict[str, Any] | None:
        """The process in which the decoder runs: `pid`, `state`, `restarts`, `last_failure`; None if there was none."""
        return self._isolation.state()

    def gate(self) -> dict[str, Any] | None:
        """Counts of the gate in front of the TLS port; None without one."""
        return None if self.transport is None else self.transport.gate()

    @property
    def worker_restarts(self) -> int:
        """Number of restarts of the decoder's process after failures."""
        return self._isolation.restarts

    def _fresh_decoder(self) -> StreamDecoder:
        return StreamDecoder(self._isolation.make_decoder, self._isolation.make_other_decoder)

    def request_key(self) -> None:
        """Ask the publisher for a key frame, soon."""
        self._key_asked_for = True
        self._want_key()

    def _want_key(self) -> None:
        self._key_wanted = True
        self._poke.set()

    def close(self) -> None:
        """End everything. A second call does nothing."""
        self._stop.set()
        self._poke.set()
        self._slot.close()
        for one in reversed(self._declared):
            one.close()
        if self.refinements is not None:
            self.refinements.close()
        if self._own_transport and self.transport is not None:
            self.transport.close()
        self._isolation.close()
        for thread in self._threads:
            if thread.is_alive() and thread is not threading.current_thread():
                thread.join(JOIN_S)
        if self._own_transport and self.transport is not None:  # it may have been opened since the first check
            self.transport.close()

    @contextmanager
    def _failing_aloud(self) -> Iterator[None]:
        """An error that ends one thread is logged and ends the receiver, so that it never hangs silently."""
        try:
            yield
        except BaseException as error:  # a panic of native code is no Exception
            if self._stop.is_set():
                return
            if not isinstance(error, TransportError):
                logger.exception("%s: the receiver stops", self.keys.prefix)
            self.failure = self.failure or told(error)
            self._end()

    def _end(self) -> None:
        """Stop receiving; received messages are still decoded."""
        self._slot.close()
        self._poke.set()
        for one in self._declared[:1]:
            one.close()

    # --- the receive thread -----------------------------------------------------------------------------------------

    def _receive(self) -> None:
        try:
            with self._failing_aloud():
                if self.transport is None:
                    self.transport = open_transport(self._endpoints, stop=self._stop)
                inbox, arrivals = self._declare(self.transport)
                self._opened.set()
                self._take_messages(inbox, arrivals)
        finally:
            self._opened.set()
            self._slot.close()
            self._poke.set()

    def _declare(self, transport: Transport) -> tuple[Inbox, Sender]:
        keys = self.keys
        self._declared.append(inbox := transport.inbox(keys.frame, DEPTH))
        self._declared.append(arrivals := transport.sender(keys.arrived(self.name), Priority.REAL_TIME))
        self._declared.append(transport.listen(keys.status, self._status_came))
        self._declared.append(transport.watch(keys.alive, self._publisher_changed))
        self._declared.append(transport.token(keys.arrived(self.name)))
        if self.refinements is not None:
            self._declared += self.refinements.declare(transport)
        if self._stop.is_set():
            inbox.close()
        return inbox, arrivals

    def _take_messages(self, inbox: Inbox, arrivals: Sender) -> None:
        turns = TurnInbox(inbox)
        while (data := turns.receive()) is not None and not self._stop.is_set():
            try:
                message = unpack(data)  # checks the checksum before anything is counted
            except DecodeError as error:
                self._once.add("decode_errors", error)
                if not isinstance(error, UnsupportedVersionError):  # no key frame would help
                    self._want_key()
                continue
            if self.stats.repeated(message):
                continue
            begins = self.stats.arrived(message, len(data))
            if begins and not message.key:
                self._want_key()
            if message.key:  # it fulfils all earlier requests; a later request needs a later key frame
                self._key_asked_for = False
            came_ns = time.monotonic_ns()
            while not self._slot.put_wait(message, TICK_S):
                if self._slot.closed:
                    return
            try:
                held_ns = time.monotonic_ns() - came_ns
                now_ns, checksum, earlier = self._clock.wall_ns(), checksum_of(data), self.stats.earlier(message)
                arrivals.put(pack_arrival(Arrival(message.frame_index, now_ns, held_ns, checksum, earlier)))
            except TransportError as error:
                self._once.add("arrival_errors", error)
            self._on_message(data)
            if self.refinements is not None:
                self.refinements.message(message)

    # --- the decode thread ------------------------------------------------------------------------------------------

    def _decode(self) -> None:
        try:
            with self._failing_aloud():
                while not self._slot.finished:
                    message = self._slot.take(TICK_S)
                    if message is not None:
                        self._give(message)
                if self.refinements is not None:
                    self.refinements.flush()
        finally:
            self._on_end()

    def _give(self, message: Message) -> None:
        refinements = self.refinements
        if refinements is not None:
            refinements.flush()
        for frame in self._frames_of(message):
            if refinements is None:
                self._on_frame(frame)
            else:
                refinements.base(frame, message)

    def _frames_of(self, message: Message) -> list[Frame]:
        if not self.decoding:
            self._have_key(message, but_decodes=False)
            if self._joined is not None:  # if this message were skipped, later ones would miss their reference
                self._joined, self._decoder = None, self._fresh_decoder()
            return []
        start = time.perf_counter()
        self.decoded = message
        try:
            if not message.key and message.stream_id != self._joined:
                self.stats.count("before_key")
                self._want_key()
                return []
            frames = self._decoder.decode(message)
        except MissingReferenceError as error:
            self._once.add("missing_references", error)
            if not message.goes_on:  # a lost part costs no more than the rest of its turn
                self._want_key()
            return []
        except UnsupportedVersionError as error:  # no key frame would help
            self._once.add("decode_errors", error)
            return []
        except WorkerError as error:
            if self._stop.is_set():
                return []
            self._once.add("decode_errors", error)
            if not error.resting:
                self._want_key()
            return []
        except LidarCodecError as error:
            self._once.add("decode_errors", error)
            self._want_key()
            return []
        except Exception as error:  # an error in the decoder: only this message is lost
            logger.exception("frame %d could not be decoded", message.frame_index)
            self._once.add("decode_errors", error)
            self._decoder = self._fresh_decoder()
            self._want_key()
            return []
        self.stats.decode_ms.add(1e3 * (time.perf_counter() - start))
        self._joined = message.stream_id
        self._have_key(message, but_decodes=True)
        return frames

    def _have_key(self, message: Message, *, but_decodes: bool) -> None:
        """Cancel the request for a key frame if this message fulfils it, unless `request_key` was called since.

        but_decodes: the message is not a key frame, but it could be decoded
        """
        if (message.key or but_decodes) and not self._key_asked_for:
            self._key_wanted = False

    # --- the control thread -----------------------------------------------------------------------------------------

    def _control(self) -> None:
        while not self._opened.wait(TICK_S):
            pass
        transport = self.transport
        if transport is None or self.failure is not None:
            return
        with self._failing_aloud():
            self._keep_in_touch(transport)

    def _keep_in_touch(self, transport: Transport) -> None:
        self._declared.append(reports := transport.sender(self.keys.report(self.name), Priority.STATUS))
        due_key = due_report = self._clock.monotonic_s()
        while not self._stop.is_set():
            now = self._clock.monotonic_s()
            try:
                if self._key_wanted and now >= due_key:
                    due_key = now + KEY_INTERVAL_S
                    if transport.ask(self.keys.control_keyframe, timeout_s=ASK_S) is not None:
                        self.stats.count("key_requests")
                if now >= self._round_trips.due_s:
                    self._round_trips.ask(lambda data: transport.ask(self.keys.control_get, data, ASK_S))
                if now >= due_report:
                    due_report = now + REPORT_S
                    self._isolation.tidy()
                    reports.put(json.dumps(self.stats.report(self.errors, self.rtt_ms)).encode())
            except TransportError as error:  # the next round tries again
                if self._stop.is_set() or self._slot.closed:
                    return
                self._once.add("control_errors", error)
            soonest = min(due_key if self._key_wanted else due_report, self._round_trips.due_s, due_report)
            self._poke.wait(max(0.01, soonest - self._clock.monotonic_s()))
            self._poke.clear()

    def _ask_time(self) -> None:
        """Ask for the publisher's time soon, because a clock jumped."""
        self._round_trips.hurry()
        self._poke.set()

    # --- handlers, in threads of the transport ----------------------------------------------------------------------

    def _status_came(self, key: str, data: bytes) -> None:
        try:
            self.status = status = read_status(data)
        except JsonRefusedError as error:
            self._once.add("status_errors", error)
            return
        preparing = status.get("preparing")  # start the process of the codec before its first message
        if self.decoding and isinstance(preparing, str) and preparing in table.installed():
            self._isolation.start(preparing)

    def _publisher_changed(self, key: str, alive: bool) -> None:
        logger.info("%s: %s", self.keys.prefix, "the publisher is online" if alive else "the publisher is offline")
        self.alive = alive
        if alive:
            self._key_wanted = True
            self._poke.set()
        elif self._until_end:
            self._end()
