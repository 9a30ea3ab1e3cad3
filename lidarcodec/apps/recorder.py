"""BackgroundRecorder: records a stream in its own thread, so that no frame waits for the disk.

If the disk is too slow, the oldest items are dropped and counted. Samples of the recorded and of the sent messages are
decoded again and compared (spot_check.py).
"""

from __future__ import annotations

import logging
import threading
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, NamedTuple

from lidarcodec.apps.once import Once
from lidarcodec.apps.spot_check import SpotCheck
from lidarcodec.errors import LidarCodecError
from lidarcodec.frame import Frame
from lidarcodec.layers import SECTORS, is_refinement
from lidarcodec.message import Message
from lidarcodec.mounting import MOUNT_TEXT, Mounting
from lidarcodec.packet import Packet
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.recording import RotatingRecorder
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.wire import pack

logger = logging.getLogger(__name__)

RecordAs = Literal["packets", "lossless"]
WAITING = 20
"""Most frames that wait for the disk: two seconds, 9 MB. A frame may have refinements beside its message."""
_FRAME_BYTES = 450_000
CLOSE_LIMIT_S = 10.0
LOSSLESS = StreamSettings(codec="pcodec", max_error_m=0.0)


@dataclass(frozen=True)
class Record:
    """Options for recording all data of a sensor, independently of what is sent over the network.

    folder: folder of the files; form: raw `packets`, or a `lossless` stream
    limits: `max_file_bytes`, `max_total_bytes`, `sync_bytes` of `recording.RotatingRecorder`
    """

    folder: Path
    form: RecordAs = "packets"
    limits: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def of(cls, given: Record | str | Path | None) -> Record | None:
        """The value itself, or a Record of a folder."""
        return cls(Path(given)) if isinstance(given, str | Path) else given


class Cloud(NamedTuple):
    """A decoded frame with points to record."""

    frame: Frame


class BackgroundRecorder:
    """Records messages and packets unchanged, frames as a lossless stream, or their points. Thread-safe.

    counts: `dropped` (disk or processor too slow), `unwritten` (items that still waited at `close`), `errors`,
            `recorded checked` and `recorded wrong` of a lossless stream, `sent checked` and `sent wrong` of messages
            given to `sent`, and the counts of the RotatingRecorder
    """

    def __init__(
        self,
        folder: Path,
        keys: StreamKeys,
        settings: StreamSettings | None = None,
        mount: Mounting | None = None,
        **limits: int,
    ) -> None:
        """mount: noted in each file, for packets, which do not say it
        limits: `max_file_bytes`, `max_total_bytes`, `sync_bytes` of the RotatingRecorder.

        Raises SettingsError for limits that contradict each other.
        """
        self._said = {} if mount is None else {MOUNT_TEXT: str(mount)}
        self._files = RotatingRecorder(folder, keys.vehicle, keys.sensor, settings, metadata=self._said, **limits)
        self._encoder: StreamEncoder | None = None
        self._queue: deque[bytes | list[Packet] | Frame | Cloud] = deque()
        self._load = Fraction(0)
        self._condition = threading.Condition()
        self._closed = False
        self._once = Once(logger)
        self._own: Counter[str] = self._once.counts
        self._recorded, self._sent = SpotCheck("recorded"), SpotCheck("sent")
        self._thread = threading.Thread(target=self._run, name="lidarcodec recorder", daemon=True)

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    def describe(self, texts: Mapping[str, str]) -> None:
        """Note these texts in each file that is begun from now on: what packets do not say of their sensor."""
        self._files.metadata = self._said | dict(texts)

    def message(self, data: bytes) -> None:
        """Record one message, packed by `wire.pack`, or one refinement, packed by `layers.pack`."""
        self._put(data)

    def packets(self, packets: Sequence[Packet]) -> None:
        """Record a batch of packets unchanged."""
        self._put(list(packets))

    def frame(self, frame: Frame) -> None:
        """Record a frame as a message of a lossless stream."""
        self._put(frame)

    def sent(self, frame: Frame, settings: StreamSettings, messages: Sequence[Message]) -> None:
        """Check samples of sent messages; they are not recorded. frame: the frame given to the encoder"""
        self._sent.offer(frame, settings, messages)

    def keep_clouds(self) -> None:
        """Call this before `start` if `cloud` will be called."""
        self._files.clouds = True

    def cloud(self, frame: Frame) -> None:
        """Record the points of a decoded frame, for viewers."""
        self._put(Cloud(frame))

    def state(self) -> dict[str, Any]:
        """For the status: counts, the current file, and why recording stopped."""
        path = self._files.path
        counts = dict(self._files.counts) | dict(self._own) | dict(self._recorded.counts) | dict(self._sent.counts)
        return {"file": None if path is None else str(path), "stopped": self._files.stopped, "counts": counts}

    def close(self) -> None:
        """Write waiting items for at most CLOSE_LIMIT_S, and end the file. A second call does nothing."""
        with self._condition:
            self._closed = True
            self._condition.notify()
        if self._thread.is_alive():
            self._thread.join(CLOSE_LIMIT_S)
        if self._thread.is_alive():
            with self._condition:
                self._own["unwritten"] = len(self._queue) + 1
            logger.error("--record: the last data could not be written within %g s", CLOSE_LIMIT_S)
        else:
            self._own.pop("unwritten", None)
        self._recorded.close()
        self._sent.close()

    @property
    def writing(self) -> bool:
        """Whether items wait for the disk. With a slow disk this can last after `close`."""
        return self._thread.is_alive()

    def _put(self, item: bytes | list[Packet] | Frame | Cloud) -> None:
        with self._condition:
            if self._closed:
                return
            self._load += _load(item)
            while self._load > WAITING:
                self._load -= _load(self._queue.popleft())
                self._own["dropped"] += 1
            self._queue.append(item)
            self._condition.notify()

    def _run(self) -> None:
        try:
            while True:
                with self._condition:
                    self._condition.wait_for(lambda: bool(self._queue) or self._closed)
                    if not self._queue:
                        break
                    item = self._queue.popleft()
                    self._load -= _load(item)
                try:
                    self._write(item)
                except LidarCodecError as error:
                    self._once.add("errors", error)
                except Exception as error:  # an error in this program loses only this item
                    logger.exception("unexpected error while recording")
                    self._once.add("errors", error)
        finally:
            self._files.close()

    def _write(self, item: bytes | list[Packet] | Frame | Cloud) -> None:
        if isinstance(item, bytes) and is_refinement(item):
            self._files.write_refinement(item)
        elif isinstance(item, bytes):
            self._files.write(item)
        elif isinstance(item, list):
            self._files.write_packets(item)
        elif isinstance(item, Cloud):
            self._files.write_cloud(item.frame)
        else:
            if self._encoder is None:
                self._encoder = StreamEncoder(LOSSLESS)
            messages = self._encoder.encode(item)
            for message in messages:
                self._files.write(pack(message))
            self._recorded.offer(item, LOSSLESS, messages)


def _load(item: bytes | list[Packet] | Frame | Cloud) -> Fraction:
    """What an item is of a frame: all refinements of a frame are one more; large ones count by their bytes."""
    if not (isinstance(item, bytes) and is_refinement(item)):
        return Fraction(1)
    return min(max(Fraction(1, SECTORS), Fraction(len(item), _FRAME_BYTES)), Fraction(WAITING, 2))
