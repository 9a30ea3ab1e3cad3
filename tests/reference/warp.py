"""The warp in pure Python: what docs/wire-format-motion.md says, number by number, and the same as the native core.

For small frames: a cell takes a millisecond.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.units import AZIMUTH_TURN, LASERS

TURN: Final = 1 << 32
HALF_TURN: Final = 1 << 31
QUARTER_TURN: Final = 1 << 30
TABLE_STEPS_PER_TURN: Final = 628_318_531
ANGLE_PER_RADIAN: Final = 683_565_276
INVERSE_CORDIC_GAIN: Final = 652_032_874
SLOTS: Final = 4096
DIRECTIONS: Final = 2048
DIRECTION: Final = TURN // DIRECTIONS
SECTORS: Final = 64
FARTHEST: Final = 1 << 23
NEAREST: Final = 1600
ARCTANGENT: Final = (
    137438953472, 81134951838, 42869480287, 21761217566, 10922836750, 5466743129, 2734038620, 1367102738, 683561799,
    341782203, 170891265, 85445653, 42722829, 21361415, 10680707, 5340354, 2670177, 1335088, 667544, 333772, 166886,
    83443, 41722, 20861, 10430, 5215, 2608, 1304, 652, 326,
)  # fmt: skip

Place = tuple[int, int]


def angle_of_table(steps: int) -> int:
    """Angle of 1e-8 rad steps."""
    return ((steps % TABLE_STEPS_PER_TURN << 32) + TABLE_STEPS_PER_TURN // 2) // TABLE_STEPS_PER_TURN % TURN


def angle_of_azimuth(azimuth: int) -> int:
    """Angle of an azimuth."""
    return ((azimuth << 32) + AZIMUTH_TURN // 2) // AZIMUTH_TURN


def cos_sin(angle: int) -> tuple[int, int]:
    """Cosine and sine, steps of 2^-30: CORDIC in rotation mode (Volder 1959)."""
    back = QUARTER_TURN <= angle < TURN - QUARTER_TURN
    left = (angle + (HALF_TURN if back else 0)) % TURN
    left = (left - TURN if left >= HALF_TURN else left) * 256
    x, y = INVERSE_CORDIC_GAIN * 1024, 0
    for i, part in enumerate(ARCTANGENT):
        sign = 1 if left >= 0 else -1
        x, y, left = x - sign * (y >> i), y + sign * (x >> i), left - sign * part
    if back:
        x, y = -x, -y
    return (x + 512) >> 10, (y + 512) >> 10


def to_polar(x: int, y: int) -> tuple[int, int]:
    """Length of a vector times the CORDIC gain 1.6467, and its angle: CORDIC in vectoring mode."""
    angle = 0
    if x < 0:
        x, y, angle = -x, -y, HALF_TURN
    for i in range(20):
        part, sign = (ARCTANGENT[i] + 128) >> 8, 1 if y >= 0 else -1
        x, y, angle = x + sign * (y >> i), y - sign * (x >> i), angle + sign * part
    return x, angle % TURN


def rounded30(value: int) -> int:
    """value / 2^30."""
    return (value + (1 << 29)) >> 30


def toward_zero(a: int, b: int) -> int:
    """a / b, rounded towards zero."""
    return abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1)


class Beam:
    """One row's beam."""

    def __init__(self, rotation: int, vertical: int, distance: int, vertical_offset: int, sideways: int) -> None:
        def length(steps: int, most: int) -> int:
            return max(-most, min(most, (steps + 312) // 625))

        self.rotation = angle_of_table(rotation)
        cos_r, sin_r = cos_sin(self.rotation)
        cos_v, sin_v = cos_sin(angle_of_table(vertical))
        self.usable = cos_v >= 1 << 28
        if not self.usable:
            self.sideways = 0
            return
        self.distance, self.sideways = length(distance, 128_000), length(sideways, 2048)
        offset = length(vertical_offset, 2048)
        self.back = rounded30(offset * sin_v)
        self.direction_x, self.direction_y, self.direction_z = rounded30(cos_v * cos_r), rounded30(cos_v * sin_r), sin_v
        self.origin_x = rounded30(-self.back * cos_r - self.sideways * sin_r)
        self.origin_y = rounded30(-self.back * sin_r + self.sideways * cos_r)
        self.origin_z = rounded30(offset * cos_v)
        self.tan_elevation, self.sec_elevation = (sin_v << 24) // cos_v, (1 << 54) // cos_v

    def point(self, length: int, azimuth: int) -> tuple[int, int, int]:
        """The point at a corrected range."""
        cos_a, sin_a = cos_sin(angle_of_azimuth(azimuth))
        p, q = (
            rounded30(length * self.direction_x) + self.origin_x,
            rounded30(length * self.direction_y) + self.origin_y,
        )
        up = rounded30(length * self.direction_z) + self.origin_z
        return rounded30(p * cos_a + q * sin_a), rounded30(q * cos_a - p * sin_a), up

    def above(self, place: Place) -> int:
        """How far a place lies above the beam."""
        away, height = place
        return height - self.origin_z - ((away + self.back) * self.tan_elevation >> 24)


class ReferenceHistory:
    """As `RangeHistory`; rows: (6, 64) as `beam_rows` gives them."""

    def __init__(self) -> None:
        self.azimuth: list[dict[int, int]] = [{}, {}]
        self.ranges = [[0] * SLOTS for _ in range(LASERS)]
        self.last = [-1, -1]

    def remember(
        self,
        ranges: npt.NDArray[np.uint16],
        azimuth: npt.NDArray[np.uint16],
        fired: npt.NDArray[np.bool_],
        rows: npt.NDArray[np.int32],
    ) -> None:
        """Takes a frame."""
        for half in range(2):
            for column in np.flatnonzero(fired[half]).tolist():
                angle = int(azimuth[half, column])
                slot = angle * SLOTS // AZIMUTH_TURN
                swept = (angle - self.last[half]) % AZIMUTH_TURN
                if self.last[half] >= 0 and swept <= 4500:
                    start = self.last[half] * SLOTS // AZIMUTH_TURN
                    for passed in range(1, (slot - start) % SLOTS):
                        self.azimuth[half].pop((start + passed) % SLOTS, None)
                self.azimuth[half][slot] = self.last[half] = angle
                for row in np.flatnonzero(rows[0] == half).tolist():
                    self.ranges[row][slot] = int(ranges[row, column])

    def expected(
        self,
        numbers: npt.NDArray[np.int32],
        azimuth: npt.NDArray[np.uint16],
        fired: npt.NDArray[np.bool_],
        rows: npt.NDArray[np.int32],
    ) -> npt.NDArray[np.uint16]:
        """(64, W), what a frame is expected to have."""
        beams = [Beam(*rows[1:, row].tolist()) for row in range(LASERS)]
        motion = numbers.tolist()
        seen: set[int] = set()
        for half in range(2):
            for value in azimuth[half][fired[half]].tolist():
                block = angle_of_azimuth(value) * SECTORS // TURN
                for row in np.flatnonzero(rows[0] == half).tolist():
                    turned_by = -beams[row].rotation % TURN * SECTORS // TURN
                    seen |= {(block + turned_by) % SECTORS, (block + turned_by + 1) % SECTORS}
        sources = {(sector + by) % SECTORS for sector in seen for by in range(-3, 4)}
        wanted = {(sector + by) % SECTORS for sector in seen for by in (-1, 0, 1)}
        out = np.zeros((LASERS, azimuth.shape[1]), np.uint16)
        for left in (False, True):
            side = [row for row, beam in enumerate(beams) if beam.usable and (beam.sideways < 0) == left]
            if not side:
                continue
            mean = sum(beams[row].sideways for row in side) // len(side)
            surface: list[dict[int, Place]] = [{} for _ in range(DIRECTIONS)]
            for row, beam in enumerate(beams):
                if beam.usable:
                    aside = beam.sideways if row in side else mean
                    _lay(self._moved(row, int(rows[0, row]), beam, motion, sources, aside), row, surface)
            met = [
                _cross(surface[d], beams, side) if d * SECTORS // DIRECTIONS in wanted else {}
                for d in range(DIRECTIONS)
            ]
            for row in side:
                half = int(rows[0, row])
                for column in np.flatnonzero(fired[half]).tolist():
                    out[row, column] = _read(met, row, beams[row], angle_of_azimuth(int(azimuth[half, column])))
        return out

    def _moved(
        self, row: int, half: int, beam: Beam, motion: list[int], sources: set[int], sideways: int
    ) -> list[tuple[int, int, int]]:
        """Angle, distance from the axis and height of the points of a row, in the order of their slots."""
        points = []
        for slot in sorted(self.azimuth[half]):
            azimuth, value = self.azimuth[half][slot], self.ranges[row][slot]
            length = 32 * value + beam.distance
            sector = (angle_of_azimuth(azimuth) - beam.rotation) % TURN * SECTORS // TURN
            if value == 0 or sector not in sources or length <= 0:
                continue
            at = beam.point(length, azimuth)
            x, y, z = (
                rounded30(sum(motion[3 * axis + k] * at[k] for k in range(3))) + motion[9 + axis] for axis in range(3)
            )
            if max(abs(x), abs(y), abs(z)) > FARTHEST:
                continue
            long, angle = to_polar(16 * x, -16 * y)
            away = (long * INVERSE_CORDIC_GAIN + (1 << 33)) >> 34
            if away >= NEAREST:
                aside = toward_zero(sideways * ANGLE_PER_RADIAN >> 10, away >> 6) * 16
                points.append(((angle + aside) % TURN, away, z))
        return points


def _lay(points: list[tuple[int, int, int]], row: int, surface: list[dict[int, Place]]) -> None:
    def put(direction: int, away: int, height: int) -> None:
        cell = surface[direction % DIRECTIONS]
        if row not in cell or away < cell[row][0]:
            cell[row] = (away, height)

    joined = [0 < (points[(k + 1) % len(points)][0] - p[0]) % TURN <= 8 * DIRECTION for k, p in enumerate(points)]
    for k, (angle, away, height) in enumerate(points):
        if not joined[k]:
            if not joined[k - 1]:
                put((angle + DIRECTION // 2) // DIRECTION, away, height)
            continue
        next_angle, next_away, next_height = points[(k + 1) % len(points)]
        apart = (next_angle - angle) % TURN
        jump = abs(next_away - away) * 16 > min(away, next_away)
        direction = -(-angle // DIRECTION)
        while (at := direction * DIRECTION - angle) <= apart:
            if jump:
                near = (away, height) if 2 * at < apart else (next_away, next_height)
                put(direction, *near)
            else:
                part = (at << 16) // apart
                rise, climb = (next_away - away) * part, (next_height - height) * part
                put(direction, away + (rise + 32768 >> 16), height + (climb + 32768 >> 16))
            direction += 1


def _cross(places: dict[int, Place], beams: list[Beam], side: list[int]) -> dict[int, int]:
    """Length of the beams of these rows to what each meets first."""
    met: dict[int, int] = {}

    def meet(row: int, away: int) -> None:
        length = (away + beams[row].back) * beams[row].sec_elevation >> 24
        if length > 0 and (row not in met or length < met[row]):
            met[row] = length

    rings, passed = sorted(places), 0
    below = []
    for ring in rings:
        while passed < len(side) and beams[side[passed]].above(places[ring]) <= 0:
            passed += 1
        while passed > 0 and beams[side[passed - 1]].above(places[ring]) > 0:
            passed -= 1
        below.append(passed)
    for k in range(1, len(rings)):
        if rings[k] - rings[k - 1] > 3:
            continue
        a, b = places[rings[k - 1]], places[rings[k]]
        apart, near = abs(b[0] - a[0]), min(a[0], b[0])
        jump = apart * 20 > near * 7 or (apart > 4800 and apart * 4 > near and abs(b[1] - a[1]) * 50 < apart)
        for row in side[min(below[k - 1 : k + 1]) : max(below[k - 1 : k + 1])]:
            start, end = beams[row].above(a), beams[row].above(b)
            if (start > 0) == (end > 0):
                continue
            if jump:
                meet(row, a[0] if 2 * abs(start) < abs(start - end) else b[0])
            else:
                meet(row, a[0] + toward_zero((b[0] - a[0]) * start, start - end))
    close: dict[int, tuple[int, int]] = {}
    for ring, passes in zip(rings, below, strict=True):
        away = places[ring][0]
        for row in set(side[max(passes - 1, 0) : passes + 1]) - met.keys():
            off = abs(beams[row].above(places[ring]))
            if off * 500 < away * 3 and (row not in close or off * close[row][1] < close[row][0] * away):
                close[row] = (off, away)
    for row, (_, away) in close.items():
        meet(row, away)
    return met


def _read(met: list[dict[int, int]], row: int, beam: Beam, azimuth: int) -> int:
    direction, part = divmod((azimuth - beam.rotation) % TURN, DIRECTION)
    left, right = met[direction].get(row, 0), met[(direction + 1) % DIRECTIONS].get(row, 0)
    if left and right:
        if abs(right - left) * 16 <= min(left, right):
            length = left + ((right - left) * part + DIRECTION // 2 >> 21)
        else:
            length = left if 2 * part < DIRECTION else right
    else:
        length = left or right
    steps = (length - beam.distance + 16) >> 5
    return 0 if length == 0 or steps > 65535 else max(steps, 1)
