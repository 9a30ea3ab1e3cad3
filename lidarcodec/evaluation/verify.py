"""Compares a recording with its source: are the packets identical, and how large are the range errors?

Settings may change while a stream runs, and a target bitrate changes the bound from frame to frame. So each frame is
checked against the bound in its own message, not against the settings at the start of the recording.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np

from lidarcodec.assembly import packets_of
from lidarcodec.assembly.short_turns import ShortTurns
from lidarcodec.codecs import table
from lidarcodec.codecs.pictures import split_head
from lidarcodec.errors import SourceError
from lidarcodec.evaluation.metrics import IntensityErrors, RangeErrors
from lidarcodec.evaluation.plane_difference import told_of_planes
from lidarcodec.evaluation.verify_positions import PositionComparison, places
from lidarcodec.evaluation.verify_values import CloudErrors, values_difference
from lidarcodec.frame import Frame
from lidarcodec.layers import RefinedFrame
from lidarcodec.message import Message, SectionType
from lidarcodec.packet import Packet, data_packets
from lidarcodec.pipeline import frames_of
from lidarcodec.planes.attribute_values import AttributeQuality
from lidarcodec.planes.clouds.section import bound_of_cloud
from lidarcodec.planes.plane_section import read_head
from lidarcodec.sensors.clouds.sensor import RANGE_STEP_M as CLOUD_STEP_M
from lidarcodec.settings import step_of
from lidarcodec.units import FRAME_PACKETS, MAX_PACKETS, RANGE_STEP_M

LATE_NS = 1_000_000_000
"""If the source has a packet that is this much later than the searched one, the searched one is not in the source."""


LOSSLESS_INTENSITY: Final = (0, 1, 3, 4)
"""Forms of an INTENSITY section that are lossless (docs/wire-format.md)."""


class Promise(NamedTuple):
    """The guarantees in a message. step: quantiser step in range steps, None if the codec has no bound; identical:
    whether the packets must be identical; reduced: whether returns were removed; told: quality of the attributes, None
    if it is not known; bound_m: largest distance of a point of a cloud from where it was"""

    step: int | None
    identical: bool
    reduced: bool = False
    told: AttributeQuality | None = None
    bound_m: float | None = None


def bound_of(step: int, range_step_m: float = RANGE_STEP_M) -> float:
    """The largest error in metres of a range that is quantised with this step."""
    return round(step // 2 * range_step_m, 6)


def promise_of(message: Message) -> Promise:
    """The guarantees of a decoded message. Codecs with a bound begin a RANGE section with their step. `raw` has no
    step, and does not say whether its intensities are complete.

    Raises UnsupportedVersionError for an unknown codec.
    """
    name = table.codec_name(message.codec)
    reduced = any(section.type in (SectionType.KEEP, SectionType.LATTICE) for section in message.sections)
    bounded = table.codec(name).bounded
    if message.planes:
        return _promise_of_planes(message, bounded=bounded)
    if not bounded:
        return Promise(None, False, reduced)
    if name == "raw":
        return Promise(1, False)
    sections = {section.type: bytes(section.data[:2]) for section in message.sections}
    intensity = sections.get(SectionType.INTENSITY, b"")
    step = int.from_bytes(sections.get(SectionType.RANGE, b""), "little") or 1
    whole = bool(intensity) and intensity[0] in LOSSLESS_INTENSITY
    told = AttributeQuality() if whole else None
    return Promise(step, step == 1 and whole and not reduced, reduced, told)


def promise_refined(promise: Promise, refined: RefinedFrame | None) -> Promise:
    """The guarantees of a message and its refinements. One missing sector leaves the bound of the base."""
    if refined is None or not refined.whole or refined.step is None:
        return promise
    identical = refined.step == 1 and refined.exact_intensity and not promise.reduced
    told = AttributeQuality() if refined.exact_intensity else promise.told
    return promise._replace(step=refined.step, identical=identical, told=told)


def _promise_of_planes(message: Message, *, bounded: bool) -> Promise:
    """The same for a message of a sensor other than an HDL-64E."""
    if message.has(SectionType.CLOUD):
        bound_m = bound_of_cloud(message.section(SectionType.CLOUD))
        return Promise(step_of(bound_m, CLOUD_STEP_M), bound_m == 0, bound_m=bound_m)
    if not message.has(SectionType.PLANES):
        return Promise(1, True)
    head = read_head(message.section(SectionType.PLANES))
    lattice = message.has(SectionType.LATTICE)
    reduced, told = head.reduced or lattice, told_of_planes(message)
    if not bounded:
        return Promise(None, False, reduced, told)
    step = split_head(message.section(SectionType.RANGE))[1] if message.has(SectionType.RANGE) else head.step
    return Promise(step, head.exact and step == 1, reduced, told)


class Coverage(NamedTuple):
    """The part of a source that is in a recording.

    packets: number of packets in the recording;  source_packets: number of packets of the source
    first, last: positions in the source of the first and the last packet in the recording, None without packets
    first_ns, last_ns: their times
    source_first_ns, source_last_ns: times of the first and the last packet of the source
    gaps: number of gaps between first and last
    """

    packets: int
    source_packets: int
    first: int | None
    last: int | None
    first_ns: int | None
    last_ns: int | None
    source_first_ns: int | None
    source_last_ns: int | None
    gaps: int

    @property
    def whole(self) -> bool:
        """Whether no packet of the source is missing."""
        return self.packets == self.source_packets

    def result(self) -> dict[str, Any]:
        """The fields as plain values; a frame is 348 packets."""
        frames = {
            "frames": round(self.packets / FRAME_PACKETS, 2),
            "source_frames": round(self.source_packets / FRAME_PACKETS, 2),
        }
        return {"whole": self.whole} | self._asdict() | frames


class PacketsByTime:
    """Finds the packets of a recording's frames in the source. It reads the source only forward.

    Frames may be missing in the recording (replaced by newer ones, or skipped by --skip). The packets in between are
    skipped and counted in `passed`. `coverage` tells which packets of the source were found.
    positions: for each of the last found packets, the position packets before it; passed_positions: position packets
    before the first skipped packet, None if no packet was skipped
    """

    def __init__(self, packets: Iterable[Packet]) -> None:
        self._packets: Iterator[Packet] = iter(packets)
        self._waiting: deque[Packet] = deque()
        self._at = self._taken = self._gaps = 0
        self._from: Packet | None = None
        self._first = self._last = 0
        self._to: Packet | None = None
        self._source_from: Packet | None = None
        self._source_to: Packet | None = None
        self._before: deque[list[Packet]] = deque([[]])  # for each waiting packet, and for the next one
        self.passed = 0
        self.positions: list[list[Packet]] = []
        self.passed_positions: list[Packet] | None = None

    def _look(self, at: int) -> Packet | None:
        while len(self._waiting) <= at:
            packet = next(self._packets, None)
            if packet is None:
                return None
            if packet.position:
                self._before[-1].append(packet)
                continue
            self._source_from, self._source_to = self._source_from or packet, packet
            self._waiting.append(packet)
            self._before.append([])
        return self._waiting[at]

    def coverage(self, stopped: Callable[[], bool] = lambda: False) -> Coverage | None:
        """The found part of the source. This reads the source to its end; None if it was stopped."""
        count = self._at + len(self._waiting)
        self._waiting.clear()
        self._before = deque([[]])
        for packet in data_packets(self._packets):
            if stopped():
                return None
            self._source_from, self._source_to = self._source_from or packet, packet
            count += 1
        self._at = count
        found = self._from is not None
        ends = (self._from, self._to, self._source_from, self._source_to)
        first_ns, last_ns, source_first_ns, source_last_ns = (None if one is None else one.stamp_ns for one in ends)
        return Coverage(
            packets=self._taken,
            source_packets=count,
            first=self._first if found else None,
            last=self._last if found else None,
            first_ns=first_ns,
            last_ns=last_ns,
            source_first_ns=source_first_ns,
            source_last_ns=source_last_ns,
            gaps=self._gaps,
        )

    def take(self, first: Packet, count: int) -> list[Packet] | None:
        """`count` packets, beginning with the packet with the time of `first`; None if the source has no such packet.

        If several packets have that time (some recorders have coarse clocks), it is the one with the same bytes.
        """
        at, found = 0, -1
        while (packet := self._look(at)) is not None and packet.stamp_ns <= first.stamp_ns + LATE_NS:
            if packet.stamp_ns == first.stamp_ns:
                found = at if found < 0 else found
                if packet.payload == first.payload:
                    found = at
                    break
            elif found >= 0:
                break
            at += 1
        if found < 0 or self._look(found + count - 1) is None:
            return None
        self.passed_positions = self._before[0] if found else None
        for _ in range(found):
            self._waiting.popleft()
            self._before.popleft()
        self.passed += found
        self.positions = [self._before.popleft() for _ in range(count)]
        taken = [self._waiting.popleft() for _ in range(count)]
        self._note(found, taken)
        return taken

    def _note(self, passed: int, taken: list[Packet]) -> None:
        """Update the coverage."""
        self._at += passed
        if taken:
            if self._from is None:
                self._from, self._first = taken[0], self._at
            elif passed:
                self._gaps += 1
            self._at += len(taken)
            self._taken += len(taken)
            self._to, self._last = taken[-1], self._at - 1

    def behind(self) -> tuple[list[Packet], bool]:
        """Position packets after the last found packets, and whether no data packet follows."""
        last = self._look(0) is None
        return self._before[0], last


@dataclass
class Comparison:
    """Differences between a recording and its source, summed frame by frame.

    beyond: number of frames with an error beyond the bound in their own message; beyond_m: the largest such error
    left_out: returns that a reducer removed; they do not count as lost
    differing: packets that are not identical although their message guarantees it
    steps: number of frames by the step in their message; None: frames of a codec without a bound
    positions: comparison of the position packets
    points: errors of the points of clouds
    others: what else is not as promised, in words -> number of frames
    short: turns that lack columns already in the source;  intensity: errors of intensities
    """

    frames: int = 0
    packets: int = 0
    identical_packets: int = 0
    not_in_source: int = 0
    beyond: int = 0
    beyond_m: float = 0.0
    left_out: int = 0
    differing: int = 0
    steps: Counter[int | None] = field(default_factory=Counter)
    errors: RangeErrors = field(default_factory=RangeErrors)
    positions: PositionComparison = field(default_factory=PositionComparison)
    points: CloudErrors = field(default_factory=CloudErrors)
    others: Counter[str] = field(default_factory=Counter)
    short: ShortTurns = field(default_factory=ShortTurns)
    intensity: IntensityErrors = field(default_factory=IntensityErrors)

    @property
    def packets_identical(self) -> bool:
        """Whether every packet of the recording is identical to the source's packet."""
        return self.identical_packets == self.packets and not self.not_in_source

    def add(self, decoded: Frame, source: PacketsByTime, promise: Promise | None = None) -> None:
        """Compare a decoded frame with its packets in the source, and with the guarantees in its message.

        Raises SectionError for a frame that was not made from packets.
        """
        back, before = places(packets_of(decoded))
        self.frames += 1
        self.packets += len(back)
        given = source.take(back[0], len(back)) if back else []
        if given is None:
            self.not_in_source += 1
            self.positions.lost(before)
            return
        self.positions.add(before, source.positions, source.passed_positions)
        same = sum(a.payload == b.payload for a, b in zip(given, back, strict=True))
        self.identical_packets += same
        if promise is not None:
            self.steps[promise.step] += 1
            self.differing += len(back) - same if promise.identical else 0
        if decoded.sensor.is_cloud:
            return self._compare_clouds(given, back, promise)
        self.short.add(decoded)
        for original in frames_of(given, decoded.sensor, f"packets:{MAX_PACKETS}"):
            self._compare(original, decoded, promise)
        return None

    def finish(self, source: PacketsByTime) -> None:
        """Call this after the last frame: compares the position packets after it."""
        behind, last = source.behind()
        self.positions.finish(behind, last=last)

    def _compare(self, original: Frame, decoded: Frame, promise: Promise | None) -> None:
        if original.range.shape != decoded.range.shape:
            raise SourceError(
                f"frame {decoded.index} of the recording has {decoded.width} columns, but the packets of that time "
                f"have {original.width}: the recording was not made from this source"
            )
        step_m = self.errors.range_step_m = decoded.sensor.range_step_m
        errors, sent = RangeErrors(range_step_m=step_m), original.range
        if promise is not None and promise.reduced:
            sent = np.where(decoded.range > 0, sent, np.uint16(0))
            self.left_out += original.points - int(np.count_nonzero(sent))
        errors.add(sent, decoded.range)
        self.errors.merge(errors)
        if original.intensity.shape == decoded.intensity.shape:
            self.intensity.add(original.intensity, decoded.intensity, (original.range > 0) & (decoded.range > 0))
        if promise is None or promise.step is None or promise.bound_m is not None:
            return
        if errors.max_steps > promise.step // 2:
            self.beyond += 1
            self.beyond_m = max(self.beyond_m, errors.max_error_m or 0.0)
        if promise.told is not None and not promise.identical:
            wrong = values_difference(decoded, original, promise.told, promise.step, reduced=promise.reduced)
            self.others.update([] if wrong is None else [wrong])

    def _compare_clouds(self, given: list[Packet], back: list[Packet], promise: Promise | None) -> None:
        differing = self.points.other_fields
        self.errors.range_step_m = CLOUD_STEP_M
        error_m = self.points.add(given, back, self.errors)
        if promise is None or promise.bound_m is None or promise.identical:
            return
        if error_m > promise.bound_m * (1 + 1e-9):
            self.beyond += 1
            self.beyond_m = max(self.beyond_m, error_m)
        if self.points.other_fields > differing:
            self.others["other fields than x, y and z that differ, or other points"] += 1

    def _shares(self) -> dict[str, Any]:
        """The share of returns that came back, and how far off their intensities are."""
        errors, intensity = self.errors, self.intensity
        points = errors.points + self.left_out
        return {
            "returns_percent": round(100 * (errors.points - errors.lost) / points, 2) if points else None,
            "intensity_max": intensity.largest if intensity.compared else None,
            "intensity_mean": round(intensity.total / intensity.compared, 4) if intensity.compared else None,
        }

    def result(self) -> dict[str, Any]:
        """The results as plain values."""
        errors = self.errors
        return {
            "frames": self.frames,
            "frames_not_in_source": self.not_in_source,
            "packets": self.packets,
            "packets_identical": self.packets_identical,
            "identical_packets": self.identical_packets,
            "position_packets": self.positions.recorded,
            "position_packets_identical": self.positions.all_identical,
            "identical_position_packets": self.positions.identical,
            "position_packets_missing": self.positions.missing,
            "points": errors.points,
            "max_error_m": round(self.points.max_m, 6) if self.points.points else errors.max_error_m,
            "rmse_m": round(self.points.rmse_m, 6) if self.points.points else errors.rmse_m,
            "lost": errors.lost,
            "invented": errors.invented,
            "left_out": self.left_out,
            **self._shares(),
            "frames_beyond_their_bound": self.beyond,
            "bounds_m": [
                bound_of(step, errors.range_step_m) for step in sorted(step for step in self.steps if step is not None)
            ],
        }
