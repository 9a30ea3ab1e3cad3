"""The fields of Ouster's packets: bits of a pixel by profile, numbers of heads, columns and tails.

Sources: Ouster's sensor documentation, "Lidar data packet format"; names and places as in ouster-sdk 1.0.1
(BSD-3-Clause).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np


class Bits(NamedTuple):
    """Bits of a pixel: `bits` bits from bit `start` on; all in one word."""

    name: str
    start: int
    bits: int

    @property
    def word(self) -> int:
        """Number of the word."""
        return self.start // 32

    @property
    def shift(self) -> int:
        """First bit in that word."""
        return self.start % 32

    @property
    def mask(self) -> int:
        """The bits in that word."""
        return ((1 << self.bits) - 1) << self.shift


class Field(NamedTuple):
    """A number of `size` bytes at `offset` of a head, a column or a tail."""

    name: str
    offset: int
    size: int

    @property
    def dtype(self) -> np.dtype[np.unsignedinteger]:
        """u8, u16, u32 or u64: the smallest that holds it."""
        return np.dtype(f"<u{next(width for width in (1, 2, 4, 8) if width >= self.size)}")


PIXELS: Final[Mapping[str, tuple[Bits, ...]]] = {
    "LEGACY": (
        Bits("range", 0, 20),
        Bits("flags", 20, 12),
        Bits("intensity", 32, 16),
        Bits("signal", 48, 16),
        Bits("near_ir", 64, 16),
    ),
    "RNG15_RFL8_NIR8": (
        Bits("range", 0, 15),
        Bits("flags", 15, 1),
        Bits("intensity", 16, 8),
        Bits("near_ir", 24, 8),
    ),
    "RNG19_RFL8_SIG16_NIR16": (
        Bits("range", 0, 19),
        Bits("flags", 19, 13),
        Bits("intensity", 32, 8),
        Bits("signal", 48, 16),
        Bits("near_ir", 64, 16),
        Bits("window", 88, 8),
    ),
    "RNG19_RFL8_SIG16_NIR16_DUAL": (
        Bits("range", 0, 19),
        Bits("flags", 19, 5),
        Bits("intensity", 24, 8),
        Bits("range2", 32, 19),
        Bits("flags2", 51, 5),
        Bits("intensity2", 56, 8),
        Bits("signal", 64, 16),
        Bits("signal2", 80, 16),
        Bits("near_ir", 96, 16),
        Bits("window", 120, 8),
    ),
    "FUSA_RNG15_RFL8_NIR8_DUAL": (
        Bits("range", 0, 15),
        Bits("flags", 15, 1),
        Bits("intensity", 16, 8),
        Bits("near_ir", 24, 8),
        Bits("range2", 32, 15),
        Bits("flags2", 47, 1),
        Bits("intensity2", 48, 8),
        Bits("window", 56, 8),
    ),
}
"""Profile -> the bits of a pixel that have a name. Reflectivity is `intensity`."""
PIXEL_WORDS: Final = {
    "LEGACY": 3,
    "RNG15_RFL8_NIR8": 1,
    "RNG19_RFL8_SIG16_NIR16": 3,
    "RNG19_RFL8_SIG16_NIR16_DUAL": 4,
    "FUSA_RNG15_RFL8_NIR8_DUAL": 2,
}
"""Profile -> words of a pixel."""
LEGACY: Final = "LEGACY"
FUSA: Final = "FUSA_RNG15_RFL8_NIR8_DUAL"

SHUTDOWN = (
    Field("thermal_countdown", 16, 1),
    Field("shot_limiting_countdown", 17, 1),
    Field("thermal_shutdown", 18, 1),
    Field("shot_limiting", 19, 1),
)
HEAD = (
    Field("packet_type", 0, 2),
    Field("frame_id", 2, 2),
    Field("init_id", 4, 3),
    Field("serial", 7, 5),
    Field("alert_flags", 12, 1),
    *SHUTDOWN,
)
HEAD_FUSA = (
    Field("packet_type", 0, 1),
    Field("init_id", 1, 3),
    Field("frame_id", 4, 4),
    Field("alert_flags", 8, 1),
    Field("serial", 11, 5),
    *SHUTDOWN,
)
CRC = Field("crc", 24, 8)
COLUMN = (Field("time_ns", 0, 8), Field("measurement_id", 8, 2), Field("status", 10, 2))
COLUMN_LEGACY = (
    Field("time_ns", 0, 8),
    Field("measurement_id", 8, 2),
    Field("frame_id", 10, 2),
    Field("encoder", 12, 4),
)
