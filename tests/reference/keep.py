"""The keep coder in pure Python: same bytes as native/src/planes/keep_coder.cpp, for reading and for tests."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError, TruncatedError
from tests.reference.mask import ROWS, SURE, TURN, Layout
from tests.reference.range_coder import MIN_PROBABILITY, SQUASH, STRETCH, BitModel, BitReader, Bits, BitWriter

DIRECTIONS: Final = 2048
SHARED: Final = 6
SPARSE, SPARSE_WITH_EARLIER = 4, 5
GAP_LIMITS: Final = [1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 100]
LONGEST_GAP: Final = 101
OLDEST, LATELY = 63, 3
PRIOR: Final = [20000, 12000, 8500, 6000, 3600, 1800, 1200]
"""Where a context starts, by the level of its direction."""

Mask = npt.NDArray[np.uint8]


class KeepMixer:
    """Weighs the log odds of four models; the weights follow the error."""

    HEAVIEST = 1 << 20

    def __init__(self) -> None:
        self._weights, self._inputs, self._mixed = [26214] * 4, [0] * 4, 0

    def mix(self, models: list[BitModel]) -> int:
        """16-bit probability, for the coder."""
        self._inputs = [STRETCH[model.p >> 10] for model in models]
        total = sum(w * x for w, x in zip(self._weights, self._inputs, strict=True)) >> 16
        self._mixed = SQUASH[max(-2048, min(2047, total)) + 2048]
        return max(MIN_PROBABILITY, min(65536 - MIN_PROBABILITY, self._mixed))

    def update(self, bit: int) -> None:
        """Learn the decision that was mixed for."""
        error = bit * 65536 - self._mixed
        for i, x in enumerate(self._inputs):
            moved = self._weights[i] + ((error * x + 0x2000) >> 14)
            self._weights[i] = max(-self.HEAVIEST, min(self.HEAVIEST, moved))


def aside_of(rotation: int) -> int:
    """Directions by which a row looks aside. rotation: of its laser, steps of 1e-8 rad."""
    angle = (((rotation % TURN) << 32) + TURN // 2) // TURN
    return ((angle + (1 << 20)) % (1 << 32) >> 21) % DIRECTIONS


def ones_below(number: int, most: int) -> int:
    """How many times 2 divides a number, at most `most`."""
    return next(place for place in range(most + 1) if number >> place & 1 or place == most)


def direction_level(direction: int) -> int:
    """How fine the lattice is that a direction is on."""
    return 5 - ones_below(direction, 5)


def age_class(rows: int) -> int:
    """Rows since a direction was kept, in classes."""
    return sum(rows > limit for limit in (1, 2, 4, 8))


def crowd_class(count: int) -> int:
    """Directions around that were kept lately, in classes."""
    return sum(count >= limit for limit in (1, 2, 3, 5, 9, 16))


def directions_of(layout: Layout, azimuth: npt.NDArray[np.uint16], row: int) -> list[int]:
    """The direction of each cell of a row."""
    half, aside = layout.half[row], aside_of(layout.rotation[row])
    at = [int(azimuth[half, column]) for column in layout.columns[half]]
    return [(one * DIRECTIONS // 36000 - aside) % DIRECTIONS for one in at]


class Above:
    """Of each direction, what the rows above say of it."""

    def __init__(self) -> None:
        self._age = [OLDEST] * DIRECTIONS

    def near(self, direction: int, reach: int) -> int:
        """`age_class` of the directions up to `reach` away."""
        return age_class(min(self._age[(direction + d) % DIRECTIONS] for d in range(-reach, reach + 1)))

    def crowd(self, direction: int) -> int:
        """6 times `crowd_class`, and the finest level, of what was kept lately up to 16 directions away."""
        around = [(direction + d) % DIRECTIONS for d in range(-16, 17)]
        lately = [direction_level(one) for one in around if self._age[one] <= LATELY]
        return 6 * crowd_class(len(lately)) + max(lately, default=0)

    def next(self, kept: set[int]) -> None:
        """A row is over, of which these directions were kept."""
        self._age = [1 if d in kept else min(age + 1, OLDEST) for d, age in enumerate(self._age)]


class Models:
    """Models by table and context, made when they are first needed; a mixer for each level."""

    def __init__(self) -> None:
        self._models: dict[tuple[int, ...], BitModel] = {}
        self.mixers = [KeepMixer() for _ in range(SHARED + 1)]

    def of(self, table: int, level: int, *context: int) -> BitModel:
        """The model of a context."""
        return self._models.setdefault((table, level, *context), BitModel(PRIOR[level]))


def code_keep(
    bits: Bits, layout: Layout, azimuth: npt.NDArray[np.uint16], rows: list[list[int]], earlier: Mask | None
) -> None:
    """Code all rows, in place."""
    models, above = Models(), Above()
    directions = [directions_of(layout, azimuth, row) for row in range(ROWS)]
    before: list[set[int]] = [set() for _ in range(ROWS + 2)]  # of each row but one
    for row in range(ROWS if earlier is not None else 0):
        assert earlier is not None
        columns = layout.columns[layout.half[row]]
        before[row + 1] = {d for d, column in zip(directions[row], columns, strict=True) if earlier[row, column]}
    for row in range(ROWS):
        lattice, gap, last, kept = 3 - ones_below(row, 3), LONGEST_GAP, 7, set()
        for k, direction in enumerate(directions[row]):
            shared = k > 0 and directions[row][k - 1] == direction
            level = SHARED if shared else direction_level(direction)
            gap_class = sum(gap > limit for limit in GAP_LIMITS)
            first = models.of(0, level, lattice, gap_class)
            sure = first.probability()
            if sure < SURE or sure > 65536 - SURE:
                bit = bits.bit(rows[row][k], sure)
                first.update(bit)
            else:
                used = [
                    first,
                    models.of(1, level, lattice, above.crowd(direction)),
                    models.of(2, level, last, gap_class),
                ]
                if earlier is None:
                    used.append(models.of(3, level, lattice, above.near(direction, 2), above.near(direction, 8)))
                else:
                    here, up, down = before[row + 1], before[row], before[row + 2]
                    beside = (direction + 1) % DIRECTIONS in here or (direction - 1) % DIRECTIONS in here
                    upright = direction in up or direction in down
                    used.append(models.of(4, level, lattice, direction in here, beside, upright))
                bit = bits.bit(rows[row][k], models.mixers[level].mix(used))
                models.mixers[level].update(bit)
                for model in used:
                    model.update(bit)
            rows[row][k] = bit
            if bit:
                kept.add(direction)
                last, gap = level, 1
            else:
                gap = min(gap + 1, LONGEST_GAP)
        above.next(kept)


def encode_keep(keep: Mask, layout: Layout, azimuth: npt.NDArray[np.uint16], earlier: Mask | None = None) -> bytes:
    """Bytes of a (64, W) keep mask, as kind 4 or 5."""
    rows = [[int(keep[row, column]) for column in layout.columns[layout.half[row]]] for row in range(ROWS)]
    bits = BitWriter()
    code_keep(bits, layout, azimuth, rows, earlier)
    return bytes([SPARSE if earlier is None else SPARSE_WITH_EARLIER]) + bits.finish()


def decode_keep(data: bytes, layout: Layout, azimuth: npt.NDArray[np.uint16], earlier: Mask | None = None) -> Mask:
    """(64, W) uint8 of kind 4 or 5. Raises SectionError or TruncatedError."""
    if not data:
        raise TruncatedError("a keep section holds no bytes")
    if data[0] not in (SPARSE, SPARSE_WITH_EARLIER):
        raise SectionError("a keep section of an unknown kind")
    if data[0] == SPARSE_WITH_EARLIER and earlier is None:
        raise SectionError("a keep section needs the mask of an earlier frame")
    rows = [[0] * layout.cells(row) for row in range(ROWS)]
    bits = BitReader(data[1:])
    code_keep(bits, layout, azimuth, rows, earlier if data[0] == SPARSE_WITH_EARLIER else None)
    bits.finish()
    keep = np.zeros((ROWS, layout.width), np.uint8)
    for row in range(ROWS):
        keep[row, layout.columns[layout.half[row]]] = rows[row]
    return keep
