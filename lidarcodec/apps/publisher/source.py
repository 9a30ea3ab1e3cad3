"""FrameFeed: reads packets of a source, and puts frames into a mailbox. By default it never waits for the consumer."""

from __future__ import annotations

import threading
from collections import Counter, deque
from typing import Any, Literal

from lidarcodec.apps.clocks import SYSTEM, Clock
from lidarcodec.apps.mailbox import Mailbox
from lidarcodec.apps.past.keeper import Keeper
from lidarcodec.apps.recorder import BackgroundRecorder, RecordAs
from lidarcodec.assembly import Assembler
from lidarcodec.errors import PacketError
from lidarcodec.frame import WHOLE, Frame
from lidarcodec.mounting import Mounting
from lidarcodec.packet import Packet
from lidarcodec.packet_rest import MAX_ODD_BYTES
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.sensor_time import SensorTime
from lidarcodec.sources.base import Source
from lidarcodec.sources.described import noted
from lidarcodec.sources.pacing import PacedSource
from lidarcodec.sources.posed import posed
from lidarcodec.sources.poses import Poses
from lidarcodec.units import FRAME_PACKETS, MAX_PACKETS, PACKET_INTERVAL_US

NOMINAL_HZ = 1e6 / (FRAME_PACKETS * PACKET_INTERVAL_US)
"""Frames of 348 packets that an HDL-64E sends in a second: 9.98."""
RECORD_BATCH = FRAME_PACKETS
Rate = float | Literal["max"]
TICK_S = 0.2


class FrameFeed:
    """Reads a source, assembles frames, and puts each into the mailbox.

    rate: frames of 348 packets a second for a source that is not live, or `max`: as fast as frames are taken
    loop: whether such a source begins again at its end
    keep: recorder of all packets or frames, and which of both it records
    keeper: keeps all frames;  mount: where the sensor sits on its vehicle
    packets, frames: number read so far
    """

    def __init__(
        self,
        source: Source,
        framing: str,
        rate: Rate,
        keep: tuple[BackgroundRecorder, RecordAs] | None = None,
        poses: Poses | None = None,
        clock: Clock = SYSTEM,
        keeper: Keeper | None = None,
        *,
        loop: bool = False,
        mount: Mounting | None = None,
    ) -> None:
        self._keeper, self.mount = keeper, mount
        self.source, self._poses = source, poses or getattr(source, "carried", None)
        self._paced: Source = source
        self._replay: PacedSource | None = None
        if rate != "max" and not source.live:
            speed = rate / NOMINAL_HZ
            self._paced = self._replay = PacedSource(source, speed=speed, loop=loop, restamp=True, now_ns=clock.wall_ns)
        elif loop and not source.live:
            self._paced = PacedSource(source, speed=float("inf"), loop=True)
        self._sensor_time = SensorTime()
        self.mailbox: Mailbox[Frame] = Mailbox(goes_on=lambda frame: frame.part.goes_on)
        self._recorder = keep[0] if keep else None
        self._record_as = keep[1] if keep else None
        self._describe()
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
        """The current sensor model; a live source may read its calibration from the stream."""
        return self.source.sensor

    @property
    def replaced(self) -> int:
        """Number of frames that a newer one replaced before they were encoded."""
        return self.mailbox.replaced

    @property
    def counts(self) -> Counter[str]:
        """Counts of source and assembler."""
        parts = (self.source.counts, self._past, self._assembler.counts)
        return sum((Counter(dict(part)) for part in parts), Counter())

    @property
    def time_source(self) -> dict[str, Any]:
        """The clock of the stamps (`host` or `recording`), and the state of the sensor's clock."""
        stamps = "host" if self.source.live or self._replay is not None else "recording"
        return {"stamps": stamps, **self._sensor_time.report(live=self.source.live)}

    def reframe(self, framing: str) -> int:
        """Change the framing after the current frame; returns the index of the first frame with it."""
        with self._lock:
            self._wanted_framing = framing
            return self.frames + 1

    def run(self, *, wait: bool) -> None:
        """Read to the end. wait: wait for the consumer instead of replacing frames.

        Raises SourceError or PacketError if the source does.
        """
        try:
            self._read(wait=wait)
        finally:  # keep what was read, even after an error
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
                if len(self._batch) >= RECORD_BATCH or len(packet.payload) > MAX_ODD_BYTES:
                    self._record_batch(self._recorder)
            last = self._assembler.follow(self.source.sensor)
            if last is not None:
                self._leave(last, wait=wait)
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
        """End `run` after the packets received so far, or at once if the source is not live."""
        self._paced.finish()

    def close(self) -> None:
        """End `run`; closes the source."""
        self._closed = True
        self._paced.close()

    def _leave(self, frame: Frame, *, wait: bool) -> bool:
        """Put a frame into the mailbox. True: there is a new assembler, so the first packet of the next frame must be
        pushed again."""
        lost = False
        frame = posed(frame, self._poses, self._shift_ns(frame.stamp_ns), self.mount)
        with self._lock:
            self.frames = frame.index + 1
            if self._wanted_framing != self._framing or self.source.sensor is not self._assembler.sensor:
                lost = self._assembler.waiting > 0
                self._renew()
        if self._recorder is not None and self._record_as == "lossless":
            self._recorder.frame(frame.with_(part=WHOLE))
        if self._keeper is not None:
            self._keeper.frame(frame.with_(part=WHOLE))
        if not wait:
            self.mailbox.put(frame)
        else:
            while not (self.mailbox.put_wait(frame, TICK_S) or self._closed or self.mailbox.closed):
                pass
        return lost

    def _shift_ns(self, stamp_ns: int) -> int:
        """Time that a replay added to the stamp of this packet. It may differ within a frame if the replay was
        delayed."""
        shifts = self._shifts
        while len(shifts) > 1 and shifts[0][0] < stamp_ns:
            shifts.popleft()
        return shifts[0][1] if shifts else 0

    def _renew(self) -> None:
        """Make a new assembler for a new framing or calibration, between two frames."""
        self._past += self._assembler.counts
        self._framing = self._wanted_framing
        self._assembler = Assembler(self.source.sensor, self._framing, first_index=self.frames)
        self._describe()

    def _describe(self) -> None:
        """Tell the recorder of packets what they do not say of their sensor."""
        if self._recorder is not None and self._record_as == "packets":
            self._recorder.describe(noted(self.source.sensor))

    def _record_batch(self, recorder: BackgroundRecorder) -> None:
        batch, self._batch = self._batch, []
        if batch:
            recorder.packets(batch)
