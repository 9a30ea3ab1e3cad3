"""StatusBoard: the status that a publisher sends once a second. Its size is bounded."""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

from lidarcodec.apps.clocks import SYSTEM, Clock
from lidarcodec.apps.publisher.followed import Standing
from lidarcodec.apps.publisher.source import FrameFeed
from lidarcodec.apps.reports import Report, read_report
from lidarcodec.apps.timings import MeanRate, Timings
from lidarcodec.settings import StreamSettings
from lidarcodec.sources.unit_calibration import note_of
from lidarcodec.transport.keys import StreamKeys

MAX_REPORTS = 16
"""Most receivers whose last report is in the status. The least trusted are dropped first, then the oldest."""
REPORT_S = 5.0
"""Older reports are not in the status."""
RATE_WINDOW_S = 5.0


class StatusBoard:
    """Counters of sent messages, and the last reports of receivers. Thread-safe."""

    def __init__(self, keys: StreamKeys, stream_id: int, clock: Clock = SYSTEM) -> None:
        self._keys, self._stream_id, self._clock = keys, stream_id, clock
        self._lock = threading.Lock()
        self._recent: deque[tuple[float, int, int]] = deque(maxlen=4096)
        self._reports: dict[str, tuple[Standing, float, Report]] = {}
        self._frames = self._messages = self._bytes = self._key_frames = 0
        self._last_index: int | None = None
        self._mean = MeanRate()
        self.no_receiver = 0
        self.left_out = 0
        self.encode_ms = Timings()
        self.put_ms = Timings()

    def sent(self, index: int, size: int, frames: int, put_ms: float, *, key: bool) -> None:
        """A message of `size` bytes and `frames` frames was put."""
        self.put_ms.add(put_ms)
        with self._lock:
            self._recent.append((time.monotonic(), size, frames))
            self._mean.add(self._recent[-1][0], frames)
            self._frames += frames
            self._messages += 1
            self._bytes += size
            self._key_frames += key
            self._last_index = index + frames - 1

    def report(self, name: str, data: bytes, standing: Standing) -> float | None:
        """Store a receiver's report. Returns its round trip in ms, if it has one.

        Invalid reports, and reports of names without a token, are ignored.
        """
        values = read_report(data) if standing > 0 else None
        if values is None:
            return None
        with self._lock:
            self._reports[name] = (standing, time.monotonic(), values)
            while len(self._reports) > MAX_REPORTS:
                del self._reports[min(self._reports, key=lambda one: self._reports[one][:2])]
        rtt_ms = values.get("rtt_ms")
        return float(rtt_ms) if isinstance(rtt_ms, int | float) else None

    def status(self, settings: StreamSettings, feed: FrameFeed, parts: Mapping[str, Any]) -> dict[str, Any]:
        """The status as plain values; docs/live.md lists the fields. parts: fields of other parts"""
        now = time.monotonic()
        with self._lock:
            while self._recent and now - self._recent[0][0] > RATE_WINDOW_S:
                self._recent.popleft()
            span = max(now - self._recent[0][0], 0.1) if len(self._recent) > 1 else None
            sizes = [size for _, size, _ in self._recent][:-1]
            frames = sum(count for *_, count in list(self._recent)[:-1])
            for name in [name for name, (_, at, _) in self._reports.items() if now - at > REPORT_S]:
                del self._reports[name]
            reports = {name: values for name, (*_, values) in self._reports.items()}
            totals = {
                "frames": self._frames,
                "messages": self._messages,
                "bytes": self._bytes,
                "key_frames": self._key_frames,
                "frame_index": self._last_index,
            }
            mean_fps, no_receiver, left_out = self._mean.fps, self.no_receiver, self.left_out
        sensor, replaced = feed.sensor, feed.replaced  # read before `assembled`, so that it is never larger
        return {
            "vehicle": self._keys.vehicle,
            "sensor": self._keys.sensor,
            "stream_id": f"{self._stream_id:016x}",
            "stamp_ns": self._clock.wall_ns(),
            "settings": settings.model_dump(),
            "sensor_model": {
                "name": sensor.name,
                "model": sensor.model,
                "calibration": sensor.origin,
                "hash": sensor.hash,
                "note": note_of(sensor),
            },
            "mount": None if feed.mount is None else feed.mount.values(),
            "time_source": feed.time_source,
            "packets": feed.packets,
            "assembled": feed.frames,
            "replaced": replaced,
            "no_receiver": no_receiver,
            "left_out": left_out,
            **totals,
            "fps": None if span is None else round(frames / span, 2),
            "mean_fps": mean_fps,
            "kbps": None if span is None else round(sum(sizes) * 8 / span / 1e3, 1),
            "encode_ms": self.encode_ms.summary(buckets=True),
            "put_ms": self.put_ms.summary(buckets=True),
            "source": dict(feed.counts),
            "reports": reports,
            **parts,
        }

    @staticmethod
    def packed(status: dict[str, Any]) -> bytes:
        """The status as JSON bytes."""
        return json.dumps(status, separators=(",", ":")).encode()
