"""CodecChooser: the codec of a stream that asks for `auto`, by what encoding one of its own frames takes here and now.

settings with codec auto -> a codec at once, so that nobody waits; the next frame -> a thread that encodes it with one
codec after the other, best first -> the first that is quick enough -> the stream changes to it
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any, Final

from lidarcodec.errors import LidarCodecError
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.ratecontrol.choosing import SHARE, Choice, choice, ranked, with_codec
from lidarcodec.settings import AUTO, StreamSettings
from lidarcodec.units import FIRINGS_PER_PACKET
from lidarcodec.wire import pack

logger = logging.getLogger(__name__)

SAMPLES: Final = 3
"""Times that a frame is encoded with each codec after a first time, in which libraries and weights are loaded."""
MOST_LEFT_OUT: Final = 32
"""Times that a target may leave the frame out before what was measured so far has to do."""
LONGEST_S: Final = 1.0
"""No other codec is tried after so long."""
HOPELESS: Final = 3.0
"""A codec that takes so many times the budget is not tried again."""
FRAME_NS: Final = 100_000_000
CLOSE_S: Final = 1.0


class CodecChooser:
    """Chooses in a thread of its own, and tells.

    interval_s: the time in which the source gives a packet
    """

    def __init__(self, interval_s: float) -> None:
        self._interval_s = interval_s
        self._chosen: Callable[[StreamSettings, str], None] = lambda asked, codec: None
        self._lock = threading.Lock()
        self._asked: StreamSettings | None = None
        self._choice: Choice | None = None
        self._waits = self._closed = False
        self._thread: threading.Thread | None = None

    def when_chosen(self, call: Callable[[StreamSettings, str], None]) -> None:
        """call: gets the settings that asked and the codec, in the thread; an error of ours that it raises is logged"""
        self._chosen = call

    def codec_for(self, settings: StreamSettings, before: str | None = None) -> StreamSettings:
        """The settings with a codec that can encode the next frame. With the codec `auto`, the next frame that is
        offered decides again, unless the same question was decided before.

        before: the codec in force, which stays until the decision where it can
        """
        with self._lock:
            if settings.codec != AUTO:
                self._asked = self._choice = None
                self._waits = False
                return settings
            if self._choice is not None and self._asked is not None and _question(self._asked) == _question(settings):
                self._asked = settings
                return with_codec(settings, self._choice.codec)
            self._asked, self._choice, self._waits = settings, None, True
        default, able = StreamSettings().codec, ranked(settings)
        known = [name for name in (before, default) if name in able]
        return with_codec(settings, (known or able)[0])

    def offer(self, frame: Frame) -> None:
        """A frame that is about to be encoded. Costs nothing where nothing is to be chosen."""
        if not self._waits:
            return
        with self._lock:
            if self._closed or self._asked is None or (self._thread is not None and self._thread.is_alive()):
                return
            self._waits = False
            self._thread = threading.Thread(
                target=self._run, args=(self._asked, frame), name="lidarcodec choosing", daemon=True
            )
            self._thread.start()

    def state(self, codec: str) -> dict[str, Any] | None:
        """For the status: `codec`, `because`, `encode_ms` of each that was tried, `budget_ms`; None for a codec that
        was named. codec: in force"""
        with self._lock:
            if self._asked is None:
                return None
            found = self._choice or Choice(codec, "until one of the next frames has decided", {}, None)
        return found._replace(codec=codec)._asdict()

    def close(self) -> None:
        """End soon; harmless when called twice."""
        self._closed = True
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(CLOSE_S)

    def _run(self, asked: StreamSettings, frame: Frame) -> None:
        packets = 0 if frame.side is None else frame.side.packets
        budget_ms = 1e3 * SHARE * self._interval_s * max(packets or frame.width // FIRINGS_PER_PACKET, 1)
        times = self._measured(asked, frame, budget_ms)
        if self._closed or not times:
            return
        found = choice(asked, times, budget_ms)
        with self._lock:
            if self._asked is None or _question(self._asked) != _question(asked):
                return  # another question came meanwhile: the next frame answers it
            self._choice, asked = found, self._asked
        logger.info("codec auto is %s: %s", found.codec, found.because)
        try:
            self._chosen(asked, found.codec)
        except LidarCodecError as error:
            logger.warning("codec auto cannot be %s: %s", found.codec, error)

    def _measured(self, asked: StreamSettings, frame: Frame, budget_ms: float) -> dict[str, float]:
        """Milliseconds of a frame by codec, best codec first, up to one that is quick enough. At a target that follows
        the path a stream may become lossless, which takes longest."""
        target = None if asked.target_kbps == AUTO else asked.target_kbps
        times: dict[str, float] = {}
        end = time.monotonic() + LONGEST_S
        for name in ranked(asked):
            settings = with_codec(asked, name).model_copy(update={"target_kbps": target})
            try:
                times[name] = encode_ms(settings, frame, budget_ms)
            except Exception as error:  # whatever a codec does, another one is tried
                logger.warning("codec auto: %s could not encode a frame: %s", name, error)
                continue
            if self._closed or times[name] <= budget_ms or time.monotonic() > end:
                break
        return times


def encode_ms(settings: StreamSettings, frame: Frame, budget_ms: float) -> float:
    """Mean milliseconds that a frame takes with these settings, messages packed.

    The first time is not counted, nor are times that the target left the frame out: they cost nothing.
    """
    encoder = StreamEncoder(settings)
    took: list[float] = []
    for number in range(1 + SAMPLES + MOST_LEFT_OUT):
        one = frame.with_(index=number, stamp_ns=frame.stamp_ns + number * FRAME_NS)
        start = time.perf_counter()
        messages = encoder.encode(one)
        for message in messages:
            pack(message)
        if messages:
            took.append(1e3 * (time.perf_counter() - start))
        if len(took) > SAMPLES or (len(took) > 1 and took[-1] > HOPELESS * budget_ms):
            break
    counted = took[1:] or took
    return sum(counted) / len(counted)


def _question(settings: StreamSettings) -> dict[str, Any]:
    """What the choice depends on."""
    return settings.model_dump(exclude={"follow", "key_interval"})


__all__ = ["CodecChooser"]
