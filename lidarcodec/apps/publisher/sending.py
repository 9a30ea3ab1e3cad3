"""Sending: the encode thread of a publisher. Newest frame -> encoder -> bytes -> network, one frame at a time."""

from __future__ import annotations

import threading
import time
from typing import NamedTuple

from lidarcodec.apps.once import Once
from lidarcodec.apps.publisher.adapting import Adapting
from lidarcodec.apps.publisher.coding import Coding
from lidarcodec.apps.publisher.flight import Flight
from lidarcodec.apps.publisher.originals import Originals
from lidarcodec.apps.publisher.references import References
from lidarcodec.apps.publisher.refining import Refining
from lidarcodec.apps.publisher.source import TICK_S, FrameFeed
from lidarcodec.apps.publisher.status import StatusBoard
from lidarcodec.apps.recorder import BackgroundRecorder
from lidarcodec.errors import TransportError
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import AUTO, StreamSettings
from lidarcodec.transport.base import Sender
from lidarcodec.wire import checksum_of, pack

KEY_INTERVAL_S = 0.5
"""Requests for a key frame are merged: at most one in this time."""
LAST_ARRIVAL_S = 2.0


class Counters(NamedTuple):
    """Counters of a publisher: of sent messages, and of errors."""

    board: StatusBoard
    once: Once


class SideOutputs(NamedTuple):
    """Other outputs: `originals` gets frames before coding, `recorder` gets sent messages and decodes some again,
    `refining` gets frames whose base was sent."""

    originals: Originals | None = None
    recorder: BackgroundRecorder | None = None
    refining: Refining | None = None


class Sending:
    """Sends the frames of a mailbox, while a receiver is connected, each after the last one has arrived.

    every:    keep frames while no receiver is connected
    matching: whether a receiver is connected; set by the publisher
    """

    def __init__(
        self,
        coding: Coding,
        feed: FrameFeed,
        flight: Flight,
        counters: Counters,
        stop: threading.Event,
        *,
        every: bool,
        side_outputs: SideOutputs,
    ) -> None:
        self._coding, self._encoder = coding, coding.encoder
        self._feed, self._mailbox, self._flight = feed, feed.mailbox, flight
        self._board, self._once = counters
        self._stop, self._every, self._side_outputs = stop, every, side_outputs
        self._encoding = threading.Lock()
        self._key_wanted = threading.Event()
        self._last_key = float("-inf")
        self._refers = False  # whether messages of this codec need earlier ones
        self._references = References()
        self._switches = 0
        self.adapting = Adapting(flight)
        self.matching = False
        self.next_index = 0
        self._within = False  # whether a part of a turn was sent, of which another part follows
        self._turn = 0  # index of the first part of the turn

    @property
    def sensor(self) -> SensorModel:
        """The sensor of the source."""
        return self._feed.sensor

    def request_key(self) -> bool:
        """Make the next message a key frame. Requests within half a second are merged. True: there already was one."""
        before = self._key_wanted.is_set()
        self._key_wanted.set()
        return before

    def apply(self, wanted: StreamSettings) -> tuple[int, bool]:
        """Use new settings between two frames. Returns the first frame with them, and whether it is a key frame."""
        with self._encoding:
            now = self._encoder.settings
            key = self._encoder.apply(wanted)  # raises before anything changes
            if wanted.codec != now.codec:
                self._flight.new_codec()
                self._refers = False
            first = self.next_index
            if wanted.framing != now.framing:
                reframed = self._feed.reframe(wanted.framing)
                if wanted == now.model_copy(update={"framing": wanted.framing}):
                    first = reframed  # frames already assembled have all new settings except the framing
            self._flight.follow(wanted.follow)
        return first, key

    def run(self, sender: Sender) -> None:
        """Send until the source ends, including frames that the encoder still holds, or until stopped."""
        while not self._stop.is_set() and not self._mailbox.finished:
            if not self.matching:
                if self._every:
                    self._stop.wait(TICK_S / 10)
                elif (frame := self._mailbox.take(TICK_S)) is not None:
                    self._coding.choosing.offer(frame)
                    self._board.no_receiver += 1
                continue
            if not (self._within or self._flight.wait(TICK_S)) or not self._coder_ready():
                continue
            frame = self._mailbox.take(TICK_S)
            if frame is not None:
                self._send(sender, frame)
        if not self._stop.is_set():
            self._flush(sender)
            self._flight.wait_landed(LAST_ARRIVAL_S)
            if self._side_outputs.refining is not None:
                self._side_outputs.refining.finish(LAST_ARRIVAL_S)

    def _coder_ready(self) -> bool:
        """Whether to take a frame from the mailbox. The last frame does not wait for a process that rests after
        failures.
        """
        isolation = self._coding.isolation
        if isolation.ready(self._coding.codec, TICK_S):
            return True
        return self._mailbox.closed and isolation.rests

    def _send(self, sender: Sender, frame: Frame) -> None:
        now = time.monotonic()
        self._within = frame.part.more
        if not frame.part.goes_on:
            self._turn = frame.index
        if self._side_outputs.originals is not None:
            self._side_outputs.originals.offer(frame)
        refining = self._side_outputs.refining
        if refining is not None:
            refining.next_frame()
        self._coding.choosing.offer(frame)
        asked = self._key_wanted.is_set() and now - self._last_key >= KEY_INTERVAL_S
        start = time.perf_counter()
        try:
            with self._encoding:
                key = not frame.part.goes_on and (self._in_doubt(chooses=self._choose_reference()) or asked)
                self.next_index = frame.index + 1
                if key:
                    self._key_wanted.clear()
                automatic = self._encoder.settings.target_kbps == AUTO
                self.adapting.aim(self._encoder, self._feed.replaced, automatic=automatic)
                messages = self._encoder.encode(frame, key=key)
                encoded, settings = self._encoder.reduced or frame, self._encoder.settings
                left_out, refinable = self._encoder.left_out, self._encoder.refinable
            data = [(message, pack(message)) for message in messages]
        except Exception as error:  # after any error the stream continues with a key frame
            if self._stop.is_set():
                return
            self._once.add("encode errors", error)
            self.request_key()
            return
        took_ms = 1e3 * (time.perf_counter() - start)
        self._board.encode_ms.add(took_ms)
        if not left_out:
            self._coding.choosing.encoded(took_ms)
        self._coding.learning.encoded()
        if any(message.key for message in messages):
            self._last_key = now
        for number, (message, packed) in enumerate(data):
            if number > 0:  # messages of the previous codec, which still held frames
                self._wait_alone()
            self._put(sender, message, packed)
        if refining is not None and not left_out:
            refining.offer(refinable, sum(len(packed) for _, packed in data))
        if left_out:
            self._board.left_out += 1
        elif self._side_outputs.recorder is not None:
            self._side_outputs.recorder.sent(encoded, settings, messages)

    def _choose_reference(self) -> bool:
        """Have the next message refer to a frame that the followed receiver has. False: its codec cannot choose."""
        references, flight = self._references, self._flight
        if flight.switches != self._switches:
            self._switches = flight.switches
            references.switched()
        references.arrived(flight.arrivals())
        return self._encoder.refer_to(None if flight.following is None else references.there())

    def _in_doubt(self, *, chooses: bool) -> bool:
        """Whether the next message would need one that is lost, or whose report is overdue. chooses: it refers to one
        that is there, or to the one at which everything began"""
        begun = self._references.begun
        return any(
            sent.key or (self._refers and (sent.index == begun if chooses else sent.index >= begun))
            for sent in self._flight.given_up()
        )

    def _wait_alone(self) -> None:
        """Wait until no message is under way: two at once could replace each other in the receiver's ring."""
        while not self._flight.wait(TICK_S, most=1) and not self._stop.is_set():
            pass

    def _put(self, sender: Sender, message: Message, data: bytes) -> None:
        index = message.frame_index
        self._refers = self._refers or message.needs is not None
        self._references.sent(index, message.needs, goes_on=message.goes_on)
        turn = self._turn if message.goes_on else index
        self._flight.sent(index, checksum_of(data), len(data), message.frame_count, key=message.key, turn=turn)
        start = time.perf_counter()
        try:
            sender.put(data)
        except TransportError as error:
            self._once.add("put errors", error)
            return
        took_ms = 1e3 * (time.perf_counter() - start)
        self._board.sent(index, len(data), message.frame_count, took_ms, key=message.key)

    def _flush(self, sender: Sender) -> None:
        try:
            with self._encoding:
                data = [(message, pack(message)) for message in self._encoder.flush()]
        except Exception as error:
            self._once.add("encode errors", error)
            return
        for message, packed in data:
            self._wait_alone()
            self._put(sender, message, packed)


__all__ = ["Counters", "Sending", "SideOutputs"]
