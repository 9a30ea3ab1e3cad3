"""What the encode thread of a publisher does: the newest frame -> encoder -> bytes -> network, one at a time."""

from __future__ import annotations

import threading
import time
from typing import NamedTuple

from lidarcodec.apps.once import Once
from lidarcodec.apps.publisher.adapting import Adapting
from lidarcodec.apps.publisher.coding import Coding
from lidarcodec.apps.publisher.flight import Flight
from lidarcodec.apps.publisher.originals import Originals
from lidarcodec.apps.publisher.source import TICK_S, FrameFeed
from lidarcodec.apps.publisher.status import StatusBoard
from lidarcodec.apps.recorder import BackgroundRecorder
from lidarcodec.errors import TransportError
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.base import Sender
from lidarcodec.wire import checksum_of, pack

KEY_INTERVAL_S = 0.5
"""Requests for a key frame are merged: at most one in this time."""
LAST_ARRIVAL_S = 2.0


class Told(NamedTuple):
    """Where a publisher counts what happens: what was sent, and what went wrong."""

    board: StatusBoard
    once: Once


class Beside(NamedTuple):
    """Who else gets frames: originals as they are before they are encoded, and what was sent, to decode some again."""

    originals: Originals | None = None
    recorder: BackgroundRecorder | None = None


class Sending:
    """Sends the frames of a mailbox, when somebody receives and the last one has arrived.

    every:    nothing is thrown away while nobody receives
    matching: whether somebody receives; set by who declares the sender
    """

    def __init__(
        self,
        coding: Coding,
        feed: FrameFeed,
        flight: Flight,
        told: Told,
        stop: threading.Event,
        *,
        every: bool,
        beside: Beside,
    ) -> None:
        self._coding, self._encoder = coding, coding.encoder
        self._feed, self._mailbox, self._flight = feed, feed.mailbox, flight
        self._board, self._once = told
        self._stop, self._every, self._beside = stop, every, beside
        self._encoding = threading.Lock()
        self._key_wanted = threading.Event()
        self._last_key = float("-inf")
        self._refers = False  # whether messages of this codec need earlier ones
        self.adapting = Adapting(flight)
        self.matching = False
        self.next_index = 0

    def request_key(self) -> bool:
        """Have the next message be a key frame; requests within half a second are one. True: this is not the first."""
        before = self._key_wanted.is_set()
        self._key_wanted.set()
        return before

    def apply(self, wanted: StreamSettings) -> tuple[int, bool]:
        """Take new settings between two frames: the first frame that has them, and whether it is a key frame."""
        with self._encoding:
            now = self._encoder.settings
            key = self._encoder.apply(wanted)  # if it refuses, nothing has changed
            if wanted.codec != now.codec:
                self._flight.new_codec()
                self._refers = False
            first = self.next_index
            if wanted.framing != now.framing:
                reframed = self._feed.reframe(wanted.framing)
                if wanted == now.model_copy(update={"framing": wanted.framing}):
                    first = reframed  # else frames that were assembled before have all that is new but the framing
            self._flight.follow(wanted.follow)
        return first, key

    def run(self, sender: Sender) -> None:
        """Send until the source ends, what the encoder still holds at the end, or until stopped."""
        while not self._stop.is_set() and not self._mailbox.finished:
            if not self.matching:
                if self._every:
                    self._stop.wait(TICK_S / 10)
                elif (frame := self._mailbox.take(TICK_S)) is not None:
                    self._coding.choosing.offer(frame)
                    self._board.no_receiver += 1
                continue
            if not self._flight.wait(TICK_S) or not self._coder_ready():
                continue
            frame = self._mailbox.take(TICK_S)
            if frame is not None:
                self._send(sender, frame)
        if not self._stop.is_set():
            self._flush(sender)
            self._flight.wait_landed(LAST_ARRIVAL_S)

    def _coder_ready(self) -> bool:
        """Whether a frame may be taken out of the mailbox. The last one does not wait for a process that rests."""
        isolation = self._coding.isolation
        if isolation.ready(self._coding.codec, TICK_S):
            return True
        return self._mailbox.closed and isolation.rests

    def _send(self, sender: Sender, frame: Frame) -> None:
        now = time.monotonic()
        if self._beside.originals is not None:
            self._beside.originals.offer(frame)
        self._coding.choosing.offer(frame)
        key = self._in_doubt() or (self._key_wanted.is_set() and now - self._last_key >= KEY_INTERVAL_S)
        start = time.perf_counter()
        try:
            with self._encoding:
                self.next_index = frame.index + 1
                if key:
                    self._key_wanted.clear()
                self.adapting.aim(self._encoder, self._feed.replaced)
                messages = self._encoder.encode(frame, key=key)
                encoded, settings = self._encoder.reduced or frame, self._encoder.settings
                left_out = self._encoder.left_out
            data = [(message, pack(message)) for message in messages]
        except Exception as error:  # whatever a codec does, the stream goes on with a key frame
            if self._stop.is_set():
                return
            self._once.add("encode errors", error)
            self.request_key()
            return
        self._board.encode_ms.add(1e3 * (time.perf_counter() - start))
        self._coding.learning.encoded()
        if any(message.key for message in messages):
            self._last_key = now
        for number, (message, packed) in enumerate(data):
            if number > 0:  # a codec that held frames back gave way to another one
                self._wait_alone()
            self._put(sender, message, packed)
        if left_out:
            self._board.left_out += 1
        elif self._beside.recorder is not None:
            self._beside.recorder.sent(encoded, settings, messages)

    def _in_doubt(self) -> bool:
        """Whether a message was given up that the next one would need: it may be missing at the receiver."""
        return any(self._refers or message.key for message in self._flight.given_up())

    def _wait_alone(self) -> None:
        """Until nothing is under way: of two put at once, one may take the other's place in a receiver's ring."""
        while not self._flight.wait(TICK_S, most=1) and not self._stop.is_set():
            pass

    def _put(self, sender: Sender, message: Message, data: bytes) -> None:
        index = message.frame_index
        self._refers = self._refers or message.needs is not None
        alone = message.needs is None
        self._flight.sent(index, checksum_of(data), len(data), message.frame_count, key=message.key, alone=alone)
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


__all__ = ["Beside", "Sending", "Told"]
