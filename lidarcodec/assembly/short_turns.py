"""Turns that lack columns: packets that a source never had, seen by gaps in the azimuth and in the times of packets.

The first and the last turn of a stream are short by nature. A sensor may also be set to send a part of each turn: a gap
at the same place in most turns is no loss. Packets that came twice, or in another order, make no gap.

>>> ShortTurns().rows()
[]
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.frame import Frame
from lidarcodec.packet_rest import PacketRest
from lidarcodec.side import SideInfo
from lidarcodec.units import AZIMUTH_TURN, counted

HALF: Final = AZIMUTH_TURN // 2
PAUSE_NS: Final = 10_000_000_000
"""After so long without packets a stream begins anew."""
LATE_NS: Final = 100_000_000
"""A packet is received so much later than another one, at most."""
SAME_PLACE: Final = 100
"""Two gaps whose ends differ by no more than this, in 0.01 degree, are at the same place."""
LEAST_TURNED: Final = AZIMUTH_TURN // 10
"""A frame tells how long a turn takes if it covers so much of one."""
MAX_GAPS: Final = 100_000
"""Gaps that are remembered; later ones are not looked for."""
REMEMBERED: Final = 8
"""Turns by which it is known how long one takes."""
NAMED: Final = 3
"""Turns that are named in a sentence."""

Whole = npt.NDArray[np.int64]


class Gap(NamedTuple):
    """Columns that are missing in one turn. begin, end: azimuths of the columns before and after, 0.01 degree"""

    turn: int
    begin: int
    end: int
    missing: int

    def beside(self, other: Gap) -> bool:
        """Whether the other is at the same place of a turn."""
        apart = (_apart(self.begin, other.begin), _apart(self.end, other.end))
        return max(apart) <= SAME_PLACE


@dataclass
class ShortTurn:
    """A turn that lacks columns. gaps: (begin, end) of each, in degrees

    turns_before: whole turns that are missing before it, or within it
    """

    turn: int
    columns: int
    missing: int
    gaps: list[tuple[float, float]]
    turns_before: int = 0

    def text(self, what: str) -> str:
        """For people. what: what it is called, `turn`"""
        places = ", ".join(f"{begin:.0f} to {end:.0f}" for begin, end in self.gaps[:NAMED])
        more = ", ..." * (len(self.gaps) > NAMED)
        return f"{what} {self.turn} lacks {self.missing:,} of {self.columns + self.missing:,} ({places}{more} degrees)"


class ShortTurns:
    """Takes the frames of a stream in order. Where some were left out, a stream begins anew. Cost: 0.5 ms a frame.

    what: what a frame is, if not a turn;  turns: frames so far
    """

    def __init__(self, what: str = "turn") -> None:
        self.turns, self._what = 0, what
        self._index = -1
        self._columns: dict[int, int] = {}
        self._gaps: list[Gap] = []
        self._before: dict[int, int] = {}
        self._periods: deque[float] = deque(maxlen=REMEMBERED)
        self._last: tuple[int, Whole] | None = None
        """Azimuth and times of the last column."""
        self._width = 0
        """Columns of the last turn that was looked at."""

    def add(self, frame: Frame) -> None:
        """Take a frame. Frames of sensors that do not turn, and of point clouds, are passed over."""
        turn, self.turns = self.turns, self.turns + 1
        if frame.index != self._index + 1:
            self._last = None
        self._index = frame.index
        times = None if frame.sensor.is_cloud else _times(frame)
        if times is None or frame.width < 2 or len(self._gaps) >= MAX_GAPS:
            self._last = None
            return
        azimuth = frame.azimuth[0].astype(np.int64)
        steps = np.diff(azimuth)
        steps += AZIMUTH_TURN * (steps < -HALF) - AZIMUTH_TURN * (steps > HALF)
        way = -1 if np.median(steps) < 0 else 1
        near = steps[np.abs(steps) < max(4 * abs(float(np.median(steps))), 1)]
        step = abs(float(near.mean())) if len(near) else 0.0
        if step < 1:  # it does not turn
            self._last = None
            return
        each = frame.width / len(times)
        enough = (1 + each / 2) * step
        start = _start(frame, step)
        place = _unwrapped((way * (azimuth - start)) % AZIMUTH_TURN)
        ordered, came = np.unique(place, return_index=True)
        if not self._periods:
            self._learn(place, times)
        self._look_before(turn, frame, way, step, enough, start, times)
        apart = np.diff(ordered)
        for at in np.flatnonzero(apart > enough).tolist():
            packets = (min(int(came[number] / each), len(times) - 1) for number in (at, at + 1))
            passed = _passed(*(times[number] for number in packets))
            if apart[at] > HALF and self._turned(passed) < 0.5 * apart[at]:
                continue  # packets in another order: the time of so far a turn did not pass
            begin, end = ((way * int(one) + start) % AZIMUTH_TURN for one in (ordered[at], ordered[at + 1]))
            self._note(turn, begin, end, round(int(apart[at]) / step) - 1, frame.width)
        self._look_for_turns(turn, place, times, each, enough)
        self._learn(place, times)
        self._last, self._width = (int(azimuth[-1]), times[-1]), frame.width

    def watched(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """The frames themselves, each of them taken before it is given."""
        for frame in frames:
            self.add(frame)
            yield frame

    def _look_before(
        self, turn: int, frame: Frame, way: int, step: float, enough: float, start: int, times: Whole
    ) -> None:
        """Note the gap between the frame before and this one: to its start it is in the turn before."""
        if self._last is None:
            return
        last, last_times = self._last
        passed = _passed(last_times, times[0])
        if passed is None and abs(int(times[0, 0] - last_times[0])) > PAUSE_NS:
            return
        first = int(frame.azimuth[0, 0])
        advance = (way * (first - last)) % AZIMUTH_TURN
        turned = self._turned(passed)
        if advance > AZIMUTH_TURN - 2 * enough:
            advance -= AZIMUTH_TURN  # a turn that ended a little behind its start
        elif advance > HALF and turned < 0.5 * advance:
            return  # an earlier place, without the time of a turn: packets in another order
        self._note_turns(turn, turned, advance, frame.width)
        if advance <= enough:
            return
        missing = round(advance / step) - 1
        to_start = (way * (start - last)) % AZIMUTH_TURN
        earlier = min(round(to_start / step), missing) if to_start < advance else missing
        if earlier == missing or turn == 0:
            self._note(turn - 1, last, first, missing, self._width)
        elif earlier * step <= SAME_PLACE:
            self._note(turn, last, first, missing, frame.width)
        else:
            self._note(turn - 1, last, start, earlier, self._width)
            self._note(turn, start, first, missing - earlier, frame.width)

    def _look_for_turns(self, turn: int, place: Whole, times: Whole, each: float, enough: float) -> None:
        """Note whole turns that are missing between two packets of a frame."""
        for at in np.flatnonzero(np.diff(times[:, 0]) > self._period / 2).tolist() if self._periods else ():
            before, after = (min(int((number + 1) * each) - 1, len(place) - 1) for number in (at, at + 1))
            advance = int(place[min(before + 1, after)] - place[before]) % AZIMUTH_TURN
            if advance > AZIMUTH_TURN - 2 * enough:
                advance -= AZIMUTH_TURN
            self._note_turns(turn, self._turned(_passed(times[at], times[at + 1])), advance, len(place))

    def _note_turns(self, turn: int, turned: float, advance: float, columns: int) -> None:
        if (whole := round((turned - advance) / AZIMUTH_TURN)) > 0:
            self._before[turn] = self._before.get(turn, 0) + whole
            self._columns[turn] = columns

    def _note(self, turn: int, begin: int, end: int, missing: int, columns: int) -> None:
        if missing > 0:
            self._gaps.append(Gap(turn, begin, end, missing))
            self._columns[turn] = columns

    @property
    def _period(self) -> float:
        """Nanoseconds of a turn: the shortest of the last ones, because with lost turns it seems longer."""
        return min(self._periods)

    def _turned(self, passed: int | None) -> float:
        """How far it turns in that time, 0.01 degree; 0 if that is not known."""
        return 0.0 if passed is None or not self._periods else passed / self._period * AZIMUTH_TURN

    def _learn(self, place: Whole, times: Whole) -> None:
        """Learn how long a turn takes."""
        turned, passed = int(place[-1] - place[0]), _passed(times[0], times[-1])
        if turned >= LEAST_TURNED and passed:
            self._periods.append(passed * AZIMUTH_TURN / turned)

    def _lost(self) -> tuple[list[Gap], list[Gap]]:
        """Gaps that are losses, and one of each that is in at least half of the turns, as the sensor is set."""
        lost: list[Gap] = []
        usual: list[Gap] = []
        often = max(2, (self.turns - 1) / 2)
        for gap in self._gaps:
            if any(gap.beside(one) for one in usual):
                continue
            beside = 0
            if len(lost) < 64:  # a usual gap is among the first ones
                beside = len({other.turn for other in self._gaps if gap.beside(other)})
            (usual if beside >= often else lost).append(gap)
        return lost, usual

    def rows(self) -> list[ShortTurn]:
        """The turns that lack columns, in order."""
        found: dict[int, ShortTurn] = {}
        for gap in self._lost()[0]:
            row = found.setdefault(gap.turn, ShortTurn(gap.turn, self._columns[gap.turn], 0, []))
            row.missing += gap.missing
            row.gaps.append((round(gap.begin / 100, 2), round(gap.end / 100, 2)))
        for turn, whole in self._before.items():
            row = found.setdefault(turn, ShortTurn(turn, self._columns[turn], 0, []))
            row.turns_before = whole
        return [found[turn] for turn in sorted(found)]

    def unsent(self) -> list[tuple[float, float]]:
        """(begin, end) in degrees of what the sensor is set not to send in each turn."""
        return [(round(gap.begin / 100, 2), round(gap.end / 100, 2)) for gap in self._lost()[1]]

    def text(self) -> str:
        """A sentence about the turns that lack columns; empty if there are none."""
        rows = self.rows()
        short = [row for row in rows if row.missing]
        told = []
        if short:
            named = ", ".join(row.text(self._what) for row in short[:NAMED]) + ", ..." * (len(short) > NAMED)
            told.append(f"{len(short)} of {self.turns} {self._what}s lack columns: {named}")
        if whole := sum(row.turns_before for row in rows):
            before = next(row.turn for row in rows if row.turns_before)
            told.append(f"{counted(whole, 'whole turn')} missing, the first of them before or in {self._what} {before}")
        return "; ".join(told)


def _apart(one: int, other: int) -> int:
    return abs((one - other + HALF) % AZIMUTH_TURN - HALF)


def _start(frame: Frame, step: float) -> int:
    """The azimuth at which turns begin: 0, or that of the first column of an Ouster."""
    side = frame.side
    numbers = side.series.get("measurement_id") if isinstance(side, PacketRest) else None
    if numbers is None or not len(numbers):
        return 0
    return round(int(frame.azimuth[0, 0]) - int(numbers[0]) * step) % AZIMUTH_TURN


def _unwrapped(place: Whole) -> Whole:
    """Places of a turn whose last columns may be beyond its end."""
    steps = np.diff(place)
    wraps = np.zeros(len(place), np.int64)
    turned = 0
    for at in np.flatnonzero(np.abs(steps) > HALF).tolist():
        turned += 1 if steps[at] < 0 else -1 if turned else 0
        wraps[at + 1 :] = turned
    found: Whole = place + AZIMUTH_TURN * wraps
    return found


def _times(frame: Frame) -> Whole | None:
    """(P, 3) of the packets that have columns: time of the host in ns, that of the sensor, and where the sensor's
    begins anew; None without columns."""
    side = frame.side
    if isinstance(side, SideInfo):
        own: npt.NDArray[Any] = side.gps_us.astype(np.int64) * 1000
        stamps, again = side.packet_ns, 3_600_000_000_000
    elif isinstance(side, PacketRest):
        stamps = side.packet_ns[side.regular]
        series, again = side.series, 1 << 62
        if (times := series.get("time_us")) is not None and len(times) == len(stamps):
            own, again = times.astype(np.int64) * 1000, 1_000_000_000  # of the hour or of the second
        elif (times := series.get("time_ns")) is not None and len(stamps) and len(times) % len(stamps) == 0:
            own = times.reshape(len(stamps), -1)[:, 0].astype(np.int64)
        else:
            own = stamps + frame.stamp_ns
    else:
        return None
    if not len(stamps):
        return None
    return np.stack([stamps + frame.stamp_ns, own, np.full(len(own), again)], axis=1)


def _passed(begin: Whole, end: Whole) -> int | None:
    """Time between two packets in ns by the clock of the sensor; None if that says nothing, or the host another time.

    The host's clock alone is no witness: packets can wait together before they are received.
    """
    host, again = int(end[0] - begin[0]), int(begin[2])
    own = host + (int(end[1] - begin[1]) - host + again // 2) % again - again // 2
    return own if 0 < host <= PAUSE_NS and 0 < own <= 2 * host + LATE_NS else None
