"""PacedSource: plays a recorded source in real time, as if the sensor were sending now."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from typing import Final

from lidarcodec.errors import SourceError
from lidarcodec.packet import Packet
from lidarcodec.sources.base import PacketSource, Source
from lidarcodec.units import PACKET_INTERVAL_US

logger = logging.getLogger(__name__)

MAX_GAP_NS: Final = 1_000_000_000
"""Longest wait between two packets: a longer gap is a cut between recordings."""
NAP_S: Final = 0.0005
"""Packets due within this time are given at once: shorter sleeps are not worth their cost."""
LATE_S: Final = 2.0
"""Packets that are given later than this are counted: a pause of the machine alone is shorter."""
LATE: Final = "late packets"


class PacedSource(PacketSource):
    """Packets of `inner` in real time, or faster or slower by `speed`.

    speed:   2 is twice as fast; infinity does not wait
    loop:    begins again at the end, with stamps that go on
    restamp: stamps become the time at which the packet is given, as from a live sensor; the distance to the packet's
             own time is `shift_ns`, so that poses can still be looked up. now_ns: host time for that

    Counts, besides those of `inner`: `late packets`, given more than two seconds after they were due. The first one
    gives a warning.
    """

    def __init__(
        self,
        inner: Source,
        *,
        speed: float = 1.0,
        loop: bool = False,
        restamp: bool = False,
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        if not speed > 0.0:
            raise SourceError(f"a replay speed must be greater than 0, not {speed}")
        super().__init__(inner.sensor, live=True)
        self.inner, self.speed, self.loop, self.restamp, self._now_ns = inner, speed, loop, restamp, now_ns
        self.shift_ns = 0
        self.counts = inner.counts
        self.label = getattr(inner, "label", "")
        self.poses = getattr(inner, "poses", None)
        self.mount = getattr(inner, "mount", None)
        self.start_ns = getattr(inner, "start_ns", None)
        self._stop = threading.Event()

    def packets(self) -> Iterator[Packet]:
        """Packets when they are due. A late reader gets overdue packets at once; none is skipped."""
        due_s, last_ns = 0.0, None
        for packet, own_ns in self._endless():
            if last_ns is None:
                due_s = time.monotonic()
            else:
                due_s += min(max(packet.stamp_ns - last_ns, 0), MAX_GAP_NS) / 1e9 / self.speed
            if not packet.position or last_ns is None or packet.stamp_ns > last_ns:  # position stamps may go back
                last_ns = packet.stamp_ns
            wait_s = due_s - time.monotonic()
            if wait_s > NAP_S and self._stop.wait(wait_s):
                return
            if self._stop.is_set():
                return
            if -wait_s > LATE_S and self.speed < float("inf"):
                self._late(-wait_s)
            if self.restamp:
                now_ns = self._now_ns()
                self.shift_ns = now_ns - own_ns
                yield packet._replace(stamp_ns=now_ns)
            else:
                self.shift_ns = packet.stamp_ns - own_ns
                yield packet

    def _late(self, late_s: float) -> None:
        if not self.counts[LATE]:
            logger.warning(
                "%s: packets come %.1f s late, because this machine does not keep up with the rate. Choose a lower "
                "one, or a sensor with fewer points",
                self.label or self.sensor.name,
                late_s,
            )
        self.counts[LATE] += 1

    def _endless(self) -> Iterator[tuple[Packet, int]]:
        """Packets with stamps that go on over the loops, and their own stamps."""
        shift_ns = 0
        while True:
            first_ns = last_ns = None
            for packet in self.inner.packets():
                if first_ns is None:
                    first_ns = packet.stamp_ns
                last_ns = packet.stamp_ns
                own = packet._replace(stamp_ns=packet.stamp_ns + shift_ns) if shift_ns else packet
                yield own, packet.stamp_ns
            if not self.loop or first_ns is None or last_ns is None or self._stop.is_set():
                return
            shift_ns += last_ns - first_ns + PACKET_INTERVAL_US * 1000

    def close(self) -> None:
        """Close the inner source; ends a `packets` that waits."""
        self._stop.set()
        super().close()
        self.inner.close()
