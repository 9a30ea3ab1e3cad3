"""PlayedSource: gives the packets of a recording when they are due. It can be paused and moved.

A change takes effect between two turns (of other sensors than an HDL-64E: between two runs of 348 packets), so that no
frame mixes two positions.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Final

from lidarcodec.assembly.rotation import RotationWatch
from lidarcodec.packet import FirstPacket, LastPacket, Packet
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.pacing import MAX_GAP_NS, NAP_S
from lidarcodec.sources.recording import RecordingSource
from lidarcodec.units import FRAME_PACKETS, MAX_PACKETS

LONGEST_WAIT_S: Final = 0.25
"""Interval of checks during a wait for the next packet, because the speed may change meanwhile."""


class PlayedSource(PacketSource):
    """Packets of a recording at its own pace times `speed`, with current stamps. Controlled from any thread.

    first_ns, last_ns: first and last stamp of the recording
    """

    def __init__(self, recording: RecordingSource, *, speed: float = 1.0, loop: bool = False) -> None:
        super().__init__(recording.sensor, live=True)
        self._recording = recording
        self.counts, self.label = recording.counts, recording.label
        self.first_ns, self.last_ns = recording.span()
        self._changed = threading.Condition()
        self._speed, self._loop, self._paused = speed, loop, False
        self._at_ns = self.first_ns
        self._wanted_ns: int | None = None
        self._shown = 0  # frames to give while paused: the frame at the new position

    @property
    def duration_s(self) -> float:
        """From the first packet to the last."""
        return (self.last_ns - self.first_ns) / 1e9

    @property
    def position_s(self) -> float:
        """Current position, in seconds of the recording."""
        at_ns = self._at_ns if self._wanted_ns is None else self._wanted_ns
        return min(max((at_ns - self.first_ns) / 1e9, 0.0), self.duration_s)

    @property
    def paused(self) -> bool:
        """Whether it is paused."""
        return self._paused

    @property
    def speed(self) -> float:
        """Speed, as a multiple of the recorded one."""
        return self._speed

    @property
    def loop(self) -> bool:
        """Whether it starts again at the end."""
        return self._loop

    def steer(
        self,
        *,
        position_s: float | None = None,
        paused: bool | None = None,
        speed: float | None = None,
        loop: bool | None = None,
    ) -> None:
        """Change the playback from the next frame on. position_s: new position, in seconds of the recording"""
        with self._changed:
            if position_s is not None:
                self._wanted_ns = self.first_ns + round(min(max(position_s, 0.0), self.duration_s) * 1e9)
                self._shown = 1
            self._paused = self._paused if paused is None else paused
            self._speed = self._speed if speed is None else speed
            self._loop = self._loop if loop is None else loop
            self._changed.notify_all()

    def packets(self) -> Iterator[Packet]:
        """Packets when they are due."""
        begin_ns: int | None = None
        while not self.closed:
            due_s, last_ns, empty = time.monotonic(), None, True
            for packet, begins in self._with_turns(begin_ns):
                empty = False
                if begins:
                    if self._held():
                        due_s = time.monotonic()
                    if self.closed or self._wanted_ns is not None:
                        break
                if last_ns is not None:
                    due_s += min(max(packet.stamp_ns - last_ns, 0), MAX_GAP_NS) / 1e9 / self._speed
                # Stamps of position packets may be out of order.
                if not packet.position or last_ns is None or packet.stamp_ns > last_ns:
                    last_ns = self._at_ns = packet.stamp_ns
                if not self._wait(due_s):
                    return
                yield packet._replace(stamp_ns=time.time_ns())
            with self._changed:
                begin_ns, self._wanted_ns = self._wanted_ns, None
                ended = begin_ns is None and (not self._loop or empty)
            if ended:
                return

    def _with_turns(self, begin_ns: int | None) -> Iterator[tuple[Packet, bool]]:
        """Packets of the recording from a time on, each with whether a turn begins with it. The first one begins a
        frame, and the last one of a turn ends it: while the playback is held, the turn before is shown."""
        rotation = RotationWatch() if self.sensor.is_hdl64e else None
        held: tuple[Packet, bool] | None = None
        number = 0
        for packet in self._recording.packets(begin_ns):
            begins = False
            if not packet.position:
                wrapped = rotation is not None and rotation.begins(packet.payload)
                begins = wrapped or number % (FRAME_PACKETS if rotation is None else MAX_PACKETS) == 0
                number = 1 if begins else number + 1
            if held is not None:
                before, began = held
                ends = begins and type(before) is Packet and not before.position
                yield (LastPacket(*before), began) if ends else held
            first = begins and held is None
            held = (FirstPacket(*packet) if first else packet, begins)
        if held is not None:
            yield held

    def close(self) -> None:
        """Close the recording; ends a `packets` that waits."""
        with self._changed:
            super().close()
            self._changed.notify_all()
        self._recording.close()

    def _held(self) -> bool:
        """Wait while it is paused and has no new position. True if there was a wait."""
        with self._changed:
            if self._shown and self._wanted_ns is None:
                self._shown -= 1
                return False
            waited = False
            while self._paused and not self.closed and self._wanted_ns is None:
                self._changed.wait(LONGEST_WAIT_S)
                waited = True
            return waited

    def _wait(self, due_s: float) -> bool:
        """Wait until `due_s`; False if it is closed meanwhile."""
        while (left_s := due_s - time.monotonic()) > NAP_S and not self.closed:
            with self._changed:
                if not self.closed:
                    self._changed.wait(min(left_s, LONGEST_WAIT_S))
        return not self.closed
