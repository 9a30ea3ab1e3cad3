"""CodecChooser: chooses the codec for `auto` by the time to encode a frame of the stream on this machine.

The stream starts at once with a default codec. A thread encodes the next frame with one codec after the other, best
first. The stream changes to the first codec that is fast enough. If the machine becomes slower or quicker, it does so
again, at intervals that grow (`ratecontrol.second_look`).
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any, Final

from lidarcodec.codecs.other_sensors import KINDS
from lidarcodec.errors import LidarCodecError
from lidarcodec.frame import Frame
from lidarcodec.packet_rest import PacketRest
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.ratecontrol.choosing import SHARE, Choice, choice, ranked, with_codec, within
from lidarcodec.ratecontrol.second_look import SecondLook
from lidarcodec.settings import AUTO, StreamSettings
from lidarcodec.units import FIRINGS_PER_PACKET
from lidarcodec.wire import pack

logger = logging.getLogger(__name__)

SAMPLES: Final = 3
"""Number of timed encodings for each codec. An untimed encoding before them loads libraries and weights."""
MOST_LEFT_OUT: Final = 32
"""Timing ends with the times so far if rate control has skipped the frame this many times."""
BRIEF_S: Final = 1.0
"""Time after which each further codec is timed once, however fast it is."""
HOPELESS: Final = 3.0
"""A codec that takes this many times the budget is not timed again."""
FRAME_NS: Final = 100_000_000
MAX_FRAME_NS: Final = 1_000_000_000
CLOSE_S: Final = 1.0


class CodecChooser:
    """Chooses the codec in its own thread, and calls back.

    interval_s: time between two packets of the source
    """

    def __init__(self, interval_s: float) -> None:
        self._interval_s = interval_s
        self._chosen: Callable[[StreamSettings, str], None] = lambda asked, codec: None
        self._lock = threading.Lock()
        self._asked: StreamSettings | None = None
        self._choice: Choice | None = None
        self._look = SecondLook()
        self._waits = self._closed = False
        self._thread: threading.Thread | None = None

    def when_chosen(self, call: Callable[[StreamSettings, str], None]) -> None:
        """call: called in the choosing thread with the settings and the chosen codec; a LidarCodecError is logged"""
        self._chosen = call

    def codec_for(self, settings: StreamSettings, before: str | None = None) -> StreamSettings:
        """The settings with a codec for the next frame. With codec `auto`, the next offered frame starts a new choice,
        unless there is one for the same settings.

        before: the current codec, which is kept until the choice if possible
        """
        with self._lock:
            if settings.codec != AUTO:
                self._look.forget()
                self._asked = self._choice = None
                self._waits = False
                return settings
            if self._choice is not None and self._asked is not None and _question(self._asked) == _question(settings):
                self._asked = settings
                return with_codec(settings, self._choice.codec)
            self._look.forget()
            self._asked, self._choice, self._waits = settings, None, True
        default, able = StreamSettings().codec, ranked(settings)
        known = [name for name in (before, default) if name in able]
        return with_codec(settings, (known or able)[0])

    def offer(self, frame: Frame) -> None:
        """A frame that will be encoded next. Costs nothing if no choice is pending."""
        if not self._waits and not self._look.due(time.monotonic()):
            return
        with self._lock:
            if self._closed or self._asked is None or (self._thread is not None and self._thread.is_alive()):
                return
            self._waits = False
            kept = None if self._choice is None else self._choice.codec
            self._thread = threading.Thread(
                target=self._run, args=(self._asked, frame, kept), name="lidarcodec choosing", daemon=True
            )
            self._thread.start()

    def encoded(self, took_ms: float) -> None:
        """A frame was encoded and not left out. Tells whether the machine is as quick as when the codec was chosen."""
        with self._lock:
            if self._thread is None or not self._thread.is_alive():  # else the trying is what slows it down
                self._look.encoded(time.monotonic(), took_ms)

    def state(self, codec: str) -> dict[str, Any] | None:
        """For the status: `codec`, `because`, `encode_ms` of each codec tried, `budget_ms`; None without `auto`.

        codec: the current one
        """
        with self._lock:
            if self._asked is None:
                return None
            found = self._choice or Choice(codec, "until one of the next frames has decided", {}, None)
        return found._replace(codec=codec)._asdict()

    def close(self) -> None:
        """Stop the thread. A second call does nothing."""
        self._closed = True
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(CLOSE_S)

    def _run(self, asked: StreamSettings, frame: Frame, kept: str | None = None) -> None:
        """kept: the codec in force, if this is not the first choice"""
        budget_ms = 1e3 * SHARE * self._duration_s(frame)
        times = self._measured(asked, frame, budget_ms, kept)
        if self._closed or not times:
            self._look.forget()
            return
        found = choice(asked, times, budget_ms, kept)
        with self._lock:
            if self._asked is None or _question(self._asked) != _question(asked):
                return  # the settings changed meanwhile: the next frame starts a new choice
            self._choice, asked = found, self._asked
            best = found.codec == next(iter(times))
            self._look.decided(time.monotonic(), times[found.codec], budget_ms, best=best)
        logger.info("codec auto is %s: %s", found.codec, found.because)
        try:
            self._chosen(asked, found.codec)
        except LidarCodecError as error:
            logger.warning("codec auto chose %s, which cannot be used: %s", found.codec, error)

    def _duration_s(self, frame: Frame) -> float:
        """Time from a frame to the next one."""
        side = frame.side
        if isinstance(side, PacketRest):  # other sensors send at rates of their own
            packets = side.packets
            span_ns = int(side.packet_ns[-1] - side.packet_ns[0]) * packets // (packets - 1) if packets > 1 else 0
            return (span_ns if 0 < span_ns < MAX_FRAME_NS else FRAME_NS) / 1e9
        packets = 0 if side is None else side.packets
        return self._interval_s * max(packets or frame.width // FIRINGS_PER_PACKET, 1)

    def _measured(self, asked: StreamSettings, frame: Frame, budget_ms: float, kept: str | None) -> dict[str, float]:
        """Encoding time in ms by codec, best codec first, up to the first that is fast enough: of all codecs if none
        is. With target `auto` the stream may become lossless, which is slowest, so lossless encoding is timed."""
        target = None if asked.target_kbps == AUTO else asked.target_kbps
        times: dict[str, float] = {}
        brief = time.monotonic() + BRIEF_S
        names = ranked(asked) if frame.sensor.is_hdl64e else [name for name in ranked(asked) if name in KINDS]
        for name in names:
            settings = with_codec(asked, name).model_copy(update={"target_kbps": target})
            samples = SAMPLES if time.monotonic() < brief else 1
            try:
                times[name] = encode_ms(settings, frame, budget_ms, samples, lambda: self._closed)
            except Exception as error:  # after any error the next codec is tried
                logger.warning("codec auto tried %s, which could not encode a frame: %s", name, error)
                continue
            if self._closed or within(name, times[name], budget_ms, kept):
                break
        return times


def encode_ms(
    settings: StreamSettings,
    frame: Frame,
    budget_ms: float,
    samples: int = SAMPLES,
    stop: Callable[[], bool] = lambda: False,
) -> float:
    """Mean time in ms to encode a frame with these settings and pack its messages.

    It does not count the first encoding, and none in which rate control skipped the frame.

    samples: number of timed encodings; stop: asked before each whether to end now, with the times so far
    """
    encoder = StreamEncoder(settings)
    took: list[float] = []
    for number in range(1 + samples + MOST_LEFT_OUT):
        one = frame.with_(index=number, stamp_ns=frame.stamp_ns + number * FRAME_NS)
        start = time.perf_counter()
        messages = encoder.encode(one)
        for message in messages:
            pack(message)
        if messages:
            took.append(1e3 * (time.perf_counter() - start))
        if stop() or len(took) > samples or (len(took) > 1 and took[-1] > HOPELESS * budget_ms):
            break
    counted = took[1:] or took
    return sum(counted) / max(len(counted), 1)


def _question(settings: StreamSettings) -> dict[str, Any]:
    """The settings that the choice depends on."""
    return settings.model_dump(exclude={"follow", "key_interval"})


__all__ = ["CodecChooser"]
