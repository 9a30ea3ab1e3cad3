"""Constants of the sensor and of its packets, with limits of a frame, and a check of numbers in texts.

HDL-64E S2 and S3 user manuals (Velodyne, rev. D 2011 and rev. K 2014), section "Data packet format".
"""

from typing import Final

PACKET_BYTES: Final = 1206
"""UDP payload: 12 blocks of 100 bytes, a 4-byte time stamp, a status type and a status value."""
BLOCKS_PER_PACKET: Final = 12
BLOCK_BYTES: Final = 100
"""2-byte flag, 2-byte azimuth, 32 x (2-byte distance, 1-byte intensity), little endian."""
LASERS_PER_BLOCK: Final = 32
TAIL_OFFSET: Final = BLOCKS_PER_PACKET * BLOCK_BYTES
UPPER_FLAG: Final = 0xEEFF
"""Lasers 0-31."""
LOWER_FLAG: Final = 0xDDFF
"""Lasers 32-63."""
LASERS: Final = 64
RANGE_STEP_M: Final = 0.002
AZIMUTH_STEP_DEG: Final = 0.01
AZIMUTH_TURN: Final = 36000
"""Azimuth steps in a full turn."""
TABLE_TURN: Final = 628_318_531
"""A full turn, 2 pi, in the calibration table's unit of angle, 1e-8 rad."""
FIRINGS_PER_PACKET: Final = 6
FRAME_PACKETS: Final = 348
"""348 x 6 firings = 2088 columns, the width of Tu 2016's range images."""
FRAME_COLUMNS: Final = FRAME_PACKETS * FIRINGS_PER_PACKET
PACKET_INTERVAL_US: Final = 288
"""Six firings of 48 us."""
HOUR_US: Final = 3_600_000_000
"""The time stamp in a packet counts microseconds since the top of the hour."""
DATA_PORT: Final = 2368
POSITION_PORT: Final = 8308
POSITION_PORTS: Final = {DATA_PORT: POSITION_PORT, 7502: 7503}
"""Usual data port of a sensor -> port of what else it sends: a Velodyne's positions, an Ouster's inertial unit."""
POSITION_BYTES: Final = 512
"""UDP payload of a position packet of every Velodyne."""
MAX_PACKETS: Final = 2048
"""Most packets in a frame: a revolution is cut there when the sensor does not turn."""
MAX_POSITIONS: Final = 2048
"""Most position packets in a frame; a sensor sends one for every 9 to 14 data packets."""
MAX_POSITION_BYTES: Final = 1472
"""Most bytes of a position packet: the largest payload in one Ethernet frame."""
MAX_POSITIONS_BYTES: Final = MAX_POSITIONS * POSITION_BYTES
"""Most bytes of all position packets of a frame together."""
MAX_COLUMNS: Final = MAX_PACKETS * BLOCKS_PER_PACKET
"""Largest width of a frame: every block may open a column of its own."""


def is_number(text: str, most: int, least: int = 0) -> bool:
    """Whether a text is a whole number from `least` to `most`, written in ASCII digits.

    >>> [is_number(text, 65535, 1) for text in ("2368", "0", "65536", "\u00b2", "9" * 5000)]
    [True, False, False, False, False]
    """
    return text.isascii() and text.isdigit() and len(text) <= 20 and least <= int(text) <= most


def counted(number: int, what: str) -> str:
    """A number of things.

    >>> counted(1, "frame"), counted(7184, "packet")
    ('1 frame', '7,184 packets')
    """
    return f"{number:,} {what}" + ("" if number == 1 else "s")
