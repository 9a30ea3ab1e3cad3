"""ReceiverStats: counts and measurements of a receiver. Its memory is bounded for any input."""

from __future__ import annotations

import logging
import secrets
import threading
import time
from collections import Counter, OrderedDict, deque
from typing import Any

from lidarcodec.apps.clocks import SYSTEM, Clock, LatencyClock
from lidarcodec.apps.receiver.freshness import OnlyBehind
from lidarcodec.apps.reports import COUNTED, EARLIER, Report
from lidarcodec.apps.timings import MeanRate, Timings
from lidarcodec.frame import Frame
from lidarcodec.message import Message

logger = logging.getLogger(__name__)

REMEMBERED = 64
"""Number of newest messages of a stream that are remembered, to detect repeated ones. Messages older than all of them
are dropped: they may be replayed by an attacker, and would show old frames as new."""
STREAMS = 8
JUMP = 36_000
"""Frames of an hour at 10 Hz. Beyond a jump this large in frame numbers, missing frames are not counted."""


def last_packet_ns(frame: Frame) -> int:
    """Host time of a frame's last packet, on the vehicle."""
    if frame.side is None or not frame.side.packets:
        return frame.stamp_ns
    return frame.stamp_ns + int(frame.side.packet_ns[-1])


class ReceiverStats:
    """Counts of one receiver. Thread-safe.

    gaps: number of gaps in frame numbers;  missing: number of missing frames, which were replaced or lost
    jumps: number of jumps of frame numbers that are too large to count missing frames
    second_publisher: how often a stream came back after another one: then two publishers have the same name
    duplicates: messages that came again, or are older than the newest 64; they are not decoded
    before_key: messages before the first key message of a stream; a decoder can start only at a key message
    clocks: difference between the publisher's clock and ours
    """

    def __init__(self, clock: Clock = SYSTEM) -> None:
        self.start = secrets.randbits(48)
        self.clocks = LatencyClock(clock)
        self._lock = threading.Lock()
        self._stream_id: int | None = None
        self._earlier: OrderedDict[int, deque[int]] = OrderedDict()
        self._next_index = 0
        self._behind = OnlyBehind()
        self._recent: deque[float] = deque(maxlen=64)
        self._mean = MeanRate()
        self.counts: Counter[str] = Counter()
        self.latency_ms = Timings()
        self.decode_ms = Timings()

    @property
    def stream_id(self) -> int | None:
        """Stream id of the publisher's current start."""
        return self._stream_id

    def repeated(self, message: Message) -> bool:
        """Whether this message is a repeated one, or older than the newest 64 of its stream; counts it if so."""
        with self._lock:
            newest = self._earlier.get(message.stream_id, deque())
            known = message.frame_index in newest
            if len(newest) == REMEMBERED and message.frame_index < min(newest):
                known = not self._behind.lasts(message.frame_index, time.monotonic())
                if not known:
                    newest.clear()
            elif not known:
                self._behind.over()
            self.counts["duplicates"] += known
            return known

    def arrived(self, message: Message, size: int) -> bool:
        """Count a received message. True: it begins another stream.

        A gap does not need a key frame: usually the publisher replaced the frames before it encoded them. If a
        reference was really lost, decoding raises an error.
        """
        with self._lock:
            self.counts["messages"] += 1
            self.counts["bytes"] += size
            begins = message.stream_id != self._stream_id
            if begins:
                self.counts["restarts"] += self._stream_id is not None
                if message.stream_id in self._earlier:
                    self.counts["second_publisher"] += 1
                    if self.counts["second_publisher"] == 1:
                        logger.warning(
                            "two publishers use the same name: give one of them another with --vehicle or --sensor"
                        )
                self._stream_id = message.stream_id
                self.clocks.restarted()
                self._earlier.setdefault(message.stream_id, deque(maxlen=REMEMBERED))
                self._earlier.move_to_end(message.stream_id)
                while len(self._earlier) > STREAMS:
                    self._earlier.popitem(last=False)
                self._next_index = 0
            elif abs(message.frame_index - self._next_index) > JUMP:
                self.counts["jumps"] += 1
                self._next_index = message.frame_index
            elif message.frame_index > self._next_index:
                self.counts["gaps"] += 1
                self.counts["missing"] += message.frame_index - self._next_index
            elif message.frame_index < self._next_index:
                self.counts["out_of_order"] += 1
            self._earlier[message.stream_id].append(message.frame_index)
            self._next_index = max(self._next_index, message.frame_index + message.frame_count)
            return begins

    def decoded(self, frame: Frame, now_ns: int) -> float | None:
        """Count a decoded frame. Returns its latency in ms, from its last packet to `now_ns`, or None if unknown."""
        latency = self.clocks.latency_ms(last_packet_ns(frame), now_ns)
        with self._lock:
            self.counts["frames"] += 1
            self.counts["clocks_apart"] += latency is None
            self._recent.append(time.monotonic())
            self._mean.add(self._recent[-1])
        if latency is not None:
            self.latency_ms.add(latency)
        return latency

    def count(self, what: str, number: int = 1) -> None:
        """Count another kind of event."""
        with self._lock:
            self.counts[what] += number

    def earlier(self, message: Message) -> int:
        """Which of the 64 indices before a message's have arrived, as bits: bit k is index - 1 - k."""
        with self._lock:
            back = (message.frame_index - 1 - index for index in self._earlier.get(message.stream_id, ()))
            return sum(1 << one for one in back if 0 <= one < EARLIER)

    @property
    def fps(self) -> float | None:
        """Frames a second over the newest 64 frames; None if none came in the last five seconds."""
        with self._lock:
            if len(self._recent) < 2 or time.monotonic() - self._recent[-1] > 5.0:
                return None
            return round((len(self._recent) - 1) / max(self._recent[-1] - self._recent[0], 1e-6), 2)

    def summary(self) -> dict[str, Any]:
        """Counts, and percentiles of latency and decoding."""
        with self._lock:
            counts, mean_fps = dict(self.counts), self._mean.fps
        return {
            **counts,
            "fps": self.fps,
            "mean_fps": mean_fps,
            "latency_ms": self.latency_ms.summary(),
            "decode_ms": self.decode_ms.summary(),
            "clock": self.clocks.state(),
        }

    def report(self, errors: Counter[str], rtt_ms: float | None) -> Report:
        """The report for the publisher, sent once a second. The module `reports` lists its fields."""
        with self._lock:
            counts = self.counts + errors
        latency, decode, clock = self.latency_ms.summary(), self.decode_ms.summary(), self.clocks.state()
        latency_buckets, latency_sum_ms = self.latency_ms.histogram()
        decode_buckets, decode_sum_ms = self.decode_ms.histogram()
        return {
            "start": self.start,
            **{name: counts[name] for name in COUNTED},
            "fps": self.fps,
            "latency_p50_ms": latency["p50"],
            "latency_p99_ms": latency["p99"],
            "decode_p50_ms": decode["p50"],
            "decode_p99_ms": decode["p99"],
            "rtt_ms": rtt_ms,
            "clock_offset_ms": clock["offset_ms"],
            "clock_bound_ms": clock["bound_ms"],
            "latency_sum_ms": latency_sum_ms,
            "decode_sum_ms": decode_sum_ms,
            "latency_buckets": latency_buckets,
            "decode_buckets": decode_buckets,
        }
