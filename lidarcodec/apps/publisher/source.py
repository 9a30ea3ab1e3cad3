"""FrameFeed: the packets of a source as frames in a mailbox. Never waits for the consumer, unless told to."""

from __future__ import annotations

import threading
from collections import Counter, deque
from typing import Any, Literal

from lidarcodec.apps.clocks import SYSTEM, Clock
from lidarcodec.apps.mailbox import Mailbox
from lidarcodec.apps.recorder import BackgroundRecorder, RecordAs
from lidarcodec.assembly import Assembler
from lidarcodec.errors import PacketError
from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.sensor_time import SensorTime
from lidarcodec.sources.base import Source
from lidarcodec.sources.pacing import PacedSource
from lidarcodec.sources.posed import posed
from lidarcodec.sources.poses import Poses
from lidarcodec.units import FRAME_PACKETS, MAX_PACKETS, PACKET_INTERVAL_US

NOMINAL_HZ = 1e6 / (FRAME_PACKETS * PACKET_INTERVAL_US)
"""Frames of 348 packets that a sensor sends in a second: 9.98."""
RECORD_BATCH = FRAME_PACKETS
Rate = float | Literal["max"]
TICK_S = 0.2


class FrameFeed:
    """Reads a source, assembles, and leaves each frame in the mailbox.

    rate: frames of 348 packets a second for a source that is not live, or `max`: as fast as frames are taken
    keep: what records all packets or frames, and which
    packets, frames: how many there were
    """

    def __init__(
        self,
        source: Source,
        framing: str,
        rate: Rate,
        keep: tuple[BackgroundRecorder, RecordAs] | None = None,
        poses: Poses | None = None,
        clock: Clock = SYSTEM,
    ) -> None:
        self.source, self._poses = source, poses
        self._paced: Source = source
        self._replay: PacedSource | None = None
        if rate != "max" and not source.live:
            speed = rate / NOMINAL_HZ
            self._paced = self._replay = PacedSource(source, speed=speed, restamp=True, now_ns=clock.wall_ns)
        self._sensor_time = SensorTime()
        self.mailbox: Mailbox[Frame] = Mailbox()
        self._recorder = keep[0] if keep else None
        self._record_as = keep[1] if keep else None
        self._lock = threading.Lock()
        self._framing = self._wanted_framing = framing
        self._assembler = Assembler(source.sensor, framing)
        self._past: Counter[str] = Counter()
        self._batch: list[Packet] = []
        self._shifts: deque[tuple[int, int]] = deque(maxlen=2 * MAX_PACKETS)
        self._closed = False
        self.packets = 0
        self.frames = 0

    @property
    def sensor(self) -> SensorModel:
        """What the numbers mean now; a live source may learn it from the stream."""
        return self.source.sensor

    @property
    def replaced(self) -> int:
        """Frames that gave way to a newer one before they were encoded."""
        return self.mailbox.replaced

    @property
    def counts(self) -> Counter[str]:
        """What the source and the assembly noticed."""
        parts = (self.source.counts, self._past, self._assembler.counts)
        return sum((Counter(dict(part)) for part in parts), Counter())

    @property
    def time_source(self) -> dict[str, Any]:
        """Whose time the stamps are (`host`, or that of the `recording`), and what the sensor says of its own."""
        stamps = "host" if self.source.live or self._replay is not None else "recording"
        return {"stamps": stamps, **self._sensor_time.report(live=self.source.live)}

    def reframe(self, framing: str) -> int:
        """Cut frames in another way, from the end of the current one on; index of the first such frame."""
        with self._lock:
            self._wanted_framing = framing
            return self.frames + 1

    def run(self, *, wait: bool) -> None:
        """Read to the end. wait: leave no frame out, the source waits instead.

        Raises SourceError or PacketError when the source does.
        """
        try:
            self._read(wait=wait)
        finally:  # what was read is kept, however the reading ended
            if self._recorder is not None:
                self._record_batch(self._recorder)

    def _read(self, *, wait: bool) -> None:
        for packet in self._paced.packets():
            if self._closed:
                return
            self.packets += not packet.position
            self._sensor_time.push(packet)
            if self._poses is not None and self._replay is not None:
                self._shifts.append((packet.stamp_ns, self._replay.shift_ns))
            if self._recorder is not None and self._record_as == "packets":
                self._batch.append(packet)
                if len(self._batch) >= RECORD_BATCH:
                    self._record_batch(self._recorder)
            try:
                frame = self._assembler.push(packet)
            except PacketError:
                self._past["wrong length"] += 1
                continue
            if frame is not None and self._leave(frame, wait=wait):
                frame = self._assembler.push(packet)
                if frame is not None:
                    self._leave(frame, wait=wait)
        last = self._assembler.flush()
        if last is not None and not self._closed:
            self._leave(last, wait=wait)

    def finish(self) -> None:
        """Have `run` end behind what has come by now, or at once if the source is not live."""
        self._paced.finish()

    def close(self) -> None:
        """End `run`; closes the source."""
        self._closed = True
        self._paced.close()

    def _leave(self, frame: Frame, *, wait: bool) -> bool:
        """Leave a frame in the mailbox. True: its assembler is gone, and took the packet behind the frame with it."""
        lost = False
        frame = posed(frame, self._poses, self._shift_ns(frame.stamp_ns))
        with self._lock:
            self.frames = frame.index + 1
            if self._wanted_framing != self._framing or self.source.sensor is not self._assembler.sensor:
                lost = self._assembler.waiting > 0
                self._renew()
        if self._recorder is not None and self._record_as == "lossless":
            self._recorder.frame(frame)
        if not wait:
            self.mailbox.put(frame)
        else:
            while not (self.mailbox.put_wait(frame, TICK_S) or self._closed or self.mailbox.closed):
                pass
        return lost

    def _shift_ns(self, stamp_ns: int) -> int:
        """How much later a replay stamped the packet of this time than its source: a replay that was held up within a
        frame stamps the last packet of that later than the first."""
        shifts = self._shifts
        while len(shifts) > 1 and shifts[0][0] < stamp_ns:
            shifts.popleft()
        return shifts[0][1] if shifts else 0

    def _renew(self) -> None:
        """Another assembler, for another framing or calibration, between two frames."""
        self._past += self._assembler.counts
        self._framing = self._wanted_framing
        self._assembler = Assembler(self.source.sensor, self._framing, first_index=self.frames)

    def _record_batch(self, recorder: BackgroundRecorder) -> None:
        batch, self._batch = self._batch, []
        if batch:
            recorder.packets(batch)
