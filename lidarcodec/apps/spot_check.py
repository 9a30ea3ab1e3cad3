"""SpotCheck: decodes some of the messages of a live stream again, and compares them with their frames.

It checks runs of messages: each run starts at a key message and uses RUN_S of processor time. Then it pauses until the
run was SHARE of all time. So the cost does not depend on the codec, and inter frames are checked, too. The thread has a
low priority. Messages that it cannot check in time are skipped.
"""

from __future__ import annotations

import contextlib
import logging
import os
import threading
import time
from collections import Counter, deque
from collections.abc import Sequence
from typing import Final, NamedTuple

from lidarcodec.codecs import table
from lidarcodec.errors import RoundTripError
from lidarcodec.evaluation.round_trip import RoundTrip
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.settings import StreamSettings
from lidarcodec.wire import pack

logger = logging.getLogger(__name__)

RUN_S: Final = 0.2
SHARE: Final = 0.04
WAITING: Final = 8
"""Most frames that wait to be checked, 5 MB."""
NICENESS: Final = 10
CLOSE_LIMIT_S: Final = 2.0


class _Item(NamedTuple):
    """A frame given to the encoder, and its messages. first: whether a run begins with it"""

    frame: Frame
    settings: StreamSettings
    messages: Sequence[Message]
    first: bool


class SpotCheck:
    """Checks one stream. Its thread starts with the first message.

    what: name of the stream in the log and in the counts
    counts: `WHAT checked`: compared frames;  `WHAT wrong`: frames that exceeded the bounds after decoding
    """

    def __init__(self, what: str) -> None:
        self.counts: Counter[str] = Counter()
        self._what = what
        self._condition = threading.Condition()
        self._queue: deque[_Item] = deque()
        self._following = self._closed = False
        self._settings: StreamSettings | None = None
        self._rest_until = 0.0
        self._check: RoundTrip | None = None
        self._used_s = 0.0
        self._thread: threading.Thread | None = None

    def offer(self, frame: Frame, settings: StreamSettings, messages: Sequence[Message]) -> None:
        """Offer a frame given to the encoder (`keep` marks its reduction), and the messages that it completed.

        Unchanged settings must be the same object.
        """
        with self._condition:
            if self._closed:
                return
            begins = not self._following
            if begins and not self._may_begin(settings, messages):
                return
            if not begins and (settings is not self._settings or len(self._queue) >= WAITING):
                self._following = False
                return
            self._following, self._settings = True, settings
            self._queue.append(_Item(frame, settings, messages, begins))
            self._condition.notify()
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="lidarcodec spot check", daemon=True)
                self._thread.start()

    def close(self) -> None:
        """Check waiting messages for at most CLOSE_LIMIT_S, and end. A second call does nothing."""
        with self._condition:
            if self._closed:
                return
            self._closed = True
            self._condition.notify()
        if self._thread is not None:
            self._thread.join(CLOSE_LIMIT_S)
        wrong, checked = self.counts[f"{self._what} wrong"], self.counts[f"{self._what} checked"]
        if wrong:
            logger.warning(
                "%s: of the checked frames, %d were wrong after decoding and %d were right", self._what, wrong, checked
            )

    def _may_begin(self, settings: StreamSettings, messages: Sequence[Message]) -> bool:
        """Whether a run may begin here. Not with codecs that have a decoder process, because their decoders may
        crash.
        """
        if not messages or not messages[0].key or time.monotonic() < self._rest_until:
            return False
        return not table.codec(settings.codec).isolated

    def _run(self) -> None:
        with contextlib.suppress(OSError):  # on Linux each thread has its own priority
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        while True:
            with self._condition:
                self._condition.wait_for(lambda: bool(self._queue) or self._closed)
                if not self._queue:
                    return
                item = self._queue.popleft()
            began = time.thread_time()
            held = self._held(item)
            self._spent(time.thread_time() - began, enough=not held)

    def _held(self, item: _Item) -> bool:
        """Whether the frames in the item's messages are within the bounds after decoding."""
        if item.first:
            self._check = RoundTrip(item.settings, joining=True)
        check = self._check
        if check is None:  # the run ended while this item waited
            return True
        before = check.compared
        try:
            check.sent(item.frame)
            for message in item.messages:
                check.message(pack(message))
        except RoundTripError as error:
            self._wrong(error)
            return False
        except Exception as error:  # an error in the check itself: the stream continues
            logger.exception("unexpected error while checking messages")
            self._wrong(error)
            return False
        finally:
            self.counts[f"{self._what} checked"] += check.compared - before
        return True

    def _wrong(self, error: Exception) -> None:
        self.counts[f"{self._what} wrong"] += 1
        if self.counts[f"{self._what} wrong"] == 1:
            logger.warning("%s: %s (more are only counted)", self._what, error)

    def _spent(self, seconds: float, *, enough: bool) -> None:
        """Count processor time, and pause after a complete run or an error."""
        self._used_s += seconds
        if not enough and self._used_s < RUN_S:
            return
        with self._condition:
            self._check, self._following = None, False
            self._queue.clear()
            self._rest_until = time.monotonic() + self._used_s / SHARE
            self._used_s = 0.0


__all__ = ["SpotCheck"]
